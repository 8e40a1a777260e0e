"""Poses from Zenoh: ``PoseStamped`` or ``PoseWithCovarianceStamped`` by key or ROS 2 topic, polled."""

from __future__ import annotations

from bridge.mocap.checks import Passed, PoseChecks, Sample, centre
from bridge.ros2.cdr import OdometryError
from bridge.ros2.pose_cdr import decode_pose, decode_pose_with_covariance
from bridge.ros2.ros2_names import parse_topic_key
from bridge.target.ros2_target import ROS_TYPES, Dialect, TargetSpec, TargetType
from bridge.zenoh import zenoh_link
from flightstack.core.types import ZERO, Vec3

CAPACITY = 256  # samples between two polls; the oldest go first
_DECODERS = {TargetType.POSE: decode_pose, TargetType.POSE_COVARIANCE: decode_pose_with_covariance}


def parse_spec(text: str, pose_type: str = TargetType.POSE.value, domain: int = 0) -> TargetSpec:
    """Understand ``KEY``, ``ros2:/TOPIC`` or ``ros2dds:/TOPIC``.

    Raises:
        ValueError: not a topic or key, or not a type of pose.
    """
    found = TargetType(pose_type)
    if found not in _DECODERS:
        raise ValueError(f"{pose_type!r} are no poses: allowed is {', '.join(t.value for t in _DECODERS)}")
    return TargetSpec.parse(text, found, domain)


class MocapSource:
    """Receives poses under one key.

    Attributes:
        problem_text: why the newest sample is unreadable, None while it is not.
    """

    def __init__(self, session: zenoh_link.Session, spec: TargetSpec, offset_flu_m: Vec3 = ZERO) -> None:
        """Subscribe.

        Args:
            session: an open Zenoh session; it stays the caller's.
            spec: key and type.
            offset_flu_m: from the markers' centre to the vehicle's, in the body's axes.

        Raises:
            ValueError: the key is not allowed.
        """
        self._subscriber = zenoh_link.ring_subscriber(session, spec.key, CAPACITY)
        self._spec, self._offset_flu_m = spec, offset_flu_m
        self._decode = _DECODERS[spec.type]
        self.problem_text: str | None = None

    def poll(self, now_s: float) -> list[Sample]:
        """Take all that has come, oldest first; never blocks."""
        return [self._sample(sample, now_s) for sample in zenoh_link.drain(self._subscriber)]

    def close(self) -> None:
        """Undeclare the subscriber."""
        self._subscriber.undeclare()

    def _sample(self, sample: zenoh_link.Sample, now_s: float) -> Sample:
        key = str(sample.key_expr)
        if self._spec.dialect is Dialect.RMW_ZENOH:
            found, wanted = parse_topic_key(key), ROS_TYPES[self._spec.type].name
            if found is None or found.type_name != wanted:
                self.problem_text = f"{key} carries another type: {wanted} is needed"
                return Sample(None, now_s)
        try:
            pose = self._decode(sample.payload.to_bytes())
        except OdometryError as error:
            self.problem_text = str(error)
            return Sample(None, now_s)
        self.problem_text = None
        return Sample(centre(pose, self._offset_flu_m), now_s)


class CheckedPoses:
    """Source and checks together, for the Crazyflie bridge: the newest good pose, or why there is none."""

    def __init__(self, source: MocapSource, checks: PoseChecks) -> None:
        self._source, self.checks = source, checks
        self._problem: str | None = "mocap: no pose yet"

    @property
    def problem(self) -> str | None:
        """Why there is no pose to rely on, None while there is."""
        return self._problem

    def poll(self, now_s: float, *, armed: bool) -> Passed | None:
        """The newest good pose since the last call."""
        step = self.checks.step(self._source.poll(now_s), now_s, armed=armed)
        self._problem = step.problem
        if self._problem is not None and self._source.problem_text is not None:
            self._problem = f"mocap: {self._source.problem_text}"
        return step.passed[-1] if step.passed else None
