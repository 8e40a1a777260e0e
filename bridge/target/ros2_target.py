"""Source of the target's motion: a Zenoh key, or a ROS 2 topic of one of three message types.

``KEY`` is a Zenoh key, ``ros2:/TOPIC`` a topic of rmw_zenoh, ``ros2dds:/TOPIC`` a topic behind
zenoh-bridge-ros2dds. The output is ``nav_msgs/msg/Odometry``: serialised, for log and replay, and also
decoded if this module made the message.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from bridge.frames import body_from_world, wrap_angle, yaw_from_quaternion
from bridge.ros2.cdr import (
    NO_COVARIANCE,
    ODOMETRY,
    POSE,
    POSE_COVARIANCE,
    Odometry,
    OdometryError,
    Pose,
    decode_odometry,
    decode_pose,
)
from bridge.ros2.ros2_names import NO_HASH, any_type_key, check_topic, parse_topic_key
from bridge.target.odometry import RawSample, excess_noise, raw_sample
from bridge.zenoh import zenoh_link
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import RESTART_S, TargetEstimator
from flightstack.core.types import ZERO, Vec3

TEXTS_MAX = 32  # maximum number of different warnings per flight; rejected samples are still counted
OFFSET_MAX_M = 5.0  # maximum offset of the landing spot on an axis, m; a larger offset may have a wrong unit
LOOK_EVERY = 100  # number of samples after which frames and covariance are checked again
CAPACITY = 1024  # maximum number of samples between two polls


class Dialect(Enum):
    PLAIN = ""
    RMW_ZENOH = "ros2:"
    ROS2DDS = "ros2dds:"


class TargetType(Enum):
    """Message types with the pose of a target."""

    ODOMETRY = "odometry"
    POSE = "pose"
    POSE_COVARIANCE = "pose-covariance"


class RosType(NamedTuple):
    name: str
    type_hash: str  # hash of the type (REP 2016); equal for these types from ROS 2 Iron on


ROS_TYPES = {
    TargetType.ODOMETRY: RosType(
        ODOMETRY, "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    ),
    TargetType.POSE: RosType(POSE, "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
    TargetType.POSE_COVARIANCE: RosType(
        POSE_COVARIANCE, "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    ),
}


@dataclass(frozen=True, slots=True)
class TargetSpec:
    text: str  # source as the user wrote it
    dialect: Dialect
    name: str  # key, or topic with the leading slash
    type: TargetType = TargetType.ODOMETRY
    domain: int = 0
    offset_m: Vec3 = ZERO  # offset of the landing spot in the axes of the tracked frame

    @classmethod
    def parse(
        cls, text: str, target_type: TargetType = TargetType.ODOMETRY, domain: int = 0, offset_m: Vec3 = ZERO
    ) -> TargetSpec:
        """Parse ``KEY``, ``ros2:/TOPIC`` or ``ros2dds:/TOPIC``."""
        if not all(abs(one) <= OFFSET_MAX_M for one in offset_m):  # this form also rejects NaN
            raise ValueError(f"offset {offset_m}: up to {OFFSET_MAX_M:g} m on each axis are allowed")
        dialect = next(
            (d for d in (Dialect.ROS2DDS, Dialect.RMW_ZENOH) if text.startswith(d.value)), Dialect.PLAIN
        )
        spec = cls(text, dialect, text.removeprefix(dialect.value), target_type, domain, offset_m)
        _ = spec.key  # raises ValueError if the source is malformed
        return spec

    @property
    def key(self) -> str:
        if self.dialect is Dialect.RMW_ZENOH:
            return any_type_key(self.domain, self.name)
        # in zenoh-bridge-ros2dds the key of a topic is the topic's name without the leading slash
        return check_topic(self.name)[1:] if self.dialect is Dialect.ROS2DDS else self.name

    def check_key(self, key: str) -> None:
        """Raise OdometryError if a key of a rmw_zenoh topic has another message type than expected."""
        if self.dialect is not Dialect.RMW_ZENOH:
            return
        found, wanted = parse_topic_key(key), ROS_TYPES[self.type]
        if found is None or found[2:] not in (wanted, (wanted.name, NO_HASH)):
            raise OdometryError(
                f"{key} carries another type: {wanted.name} with hash {wanted.type_hash} is needed; give "
                "--target-type or --pose-type if its type is intended"
            )

    def pose(self, payload: bytes) -> Pose:
        """Return the pose of the offset point in a message. Raises OdometryError: not a usable pose."""
        return decode_pose(payload, ROS_TYPES[self.type].name).shifted(self.offset_m)

    def described(self) -> dict[str, str]:
        """Return the source and processing of the odometry as text for the log."""
        x, y, z = self.offset_m
        return {"target": self.text, "target_type": self.type.value, "target_offset_m": f"{x:g} {y:g} {z:g}"}

    @property
    def is_direct(self) -> bool:
        """Whether the target is odometry on a Zenoh key, like a simulated target, also in lockstep."""
        plain = self.dialect is Dialect.PLAIN and self.type is TargetType.ODOMETRY
        return plain and self.offset_m == ZERO


SETTLED_M_S = 0.05  # maximum usable standard deviation of velocity, m/s; a TurtleBot3 Burger drives 0.22 m/s
UNKNOWN_M_S = 100.0  # standard deviation of an unmeasured velocity, m/s; far above robot speeds
GATE_SIGMAS = 6.0  # minimum distance of an outlier from the expected position, sigmas; chance: < 1 in 10^7
# number of consecutive poses that are outliers or too old, after which the estimate restarts
OUTLIERS_MAX = 5
UNSETTLED_MAX = 50  # number of poses without a velocity after which a warning is sent


class PoseTrack:
    """Converts poses of a target into odometry of ``child_frame_id`` by estimating the velocity.

    The stack's estimator expects position and velocity; here the velocity is 0, with so large a noise that
    this value has no influence. Odometry is the measured pose with the estimated velocity; no odometry is
    made before the estimate has settled, or from an outlier. ``link``: noise of poses and motion.
    """

    def __init__(self, link: TargetLink, child_frame_id: str) -> None:
        self._estimator = TargetEstimator(replace(link, velocity_noise_m_s=UNKNOWN_M_S))
        self._noise_m, self._child = link.position_noise_m, child_frame_id
        self._last: Pose | None = None  # last accepted pose
        self._strange = 0  # number of consecutive poses that are outliers or older than ``_last``
        self._unsettled = 0  # number of poses since the last restart of the estimator
        self.problem = ""  # reason why poses result in no odometry, or empty

    def take(self, pose: Pose) -> Odometry | None:
        """Return the odometry computed from a pose; None: repeated pose, outlier, or unknown velocity."""
        time_s, last = pose.stamp_ns / 1e9, self._last
        step_s = (pose.stamp_ns - last.stamp_ns) / 1e9 if last is not None else math.inf
        if step_s == 0.0:
            return None
        # a larger backward step is a restart of the sender's clock
        if -RESTART_S <= step_s < 0.0 or (0.0 < step_s <= RESTART_S and self._is_outlier(pose, time_s)):
            self._strange += 1
            if self._strange < OUTLIERS_MAX:
                return None
            step_s = math.inf
        if not 0.0 < step_s <= RESTART_S:
            self._estimator.memory.time_s = math.nan
            last = None
        self._strange, self._last = 0, pose
        q = pose.orientation_wxyz
        yaw_rad = yaw_from_quaternion(q)
        self._estimator.update(time_s, pose.position_m, ZERO, yaw_rad)
        motion = self._estimator.at(time_s)
        self._unsettled = 0 if last is None else self._unsettled + 1
        if last is None or motion.velocity_sigma_m_s > SETTLED_M_S:
            if self._unsettled >= UNSETTLED_MAX:
                self.problem = (
                    f"the velocity is known to {motion.velocity_sigma_m_s:.3f} m/s after so many poses, "
                    f"{SETTLED_M_S:g} m/s are needed: send more of them, or set target.position_noise_m and "
                    "target.jerk_xy_m_s3_sqrthz lower if that is true; no pose is used"
                )
            return None
        self.problem = ""
        # The yaw rate between two poses is not filtered; only the log uses it.
        turned_rad = wrap_angle(yaw_rad - yaw_from_quaternion(last.orientation_wxyz))
        return Odometry(
            pose.stamp_ns,
            pose.frame_id,
            self._child,
            pose.position_m,
            q,
            body_from_world(q, motion.velocity_enu_m_s),
            body_from_world(q, (0.0, 0.0, turned_rad / step_s)),
            pose.covariance,
        )

    def _is_outlier(self, pose: Pose, time_s: float) -> bool:
        expected = self._estimator.at(time_s)
        allowed_m = GATE_SIGMAS * math.hypot(expected.position_sigma_m, self._noise_m)
        return not math.dist(pose.position_m, expected.position_enu_m) <= allowed_m  # NaN is an outlier, too


class TargetSource:
    """Receives the target's motion; the owner polls, because there are no callbacks.

    ``session``: session of the caller; ``frame_id``: required frame of poses; ``child_frame_id``: required
    frame of the target, also used in odometry made from poses; ``link``: noise of poses, to estimate the
    velocity; ``lossless``: a full queue blocks the sender instead of dropping samples (lockstep). Raises
    ValueError: the key is not allowed.
    """

    def __init__(
        self,
        session: zenoh_link.Session,
        spec: TargetSpec,
        frame_id: str,
        child_frame_id: str,
        link: TargetLink,
        *,
        lossless: bool = False,
    ) -> None:
        declare = zenoh_link.fifo_subscriber if lossless else zenoh_link.ring_subscriber
        self._subscriber = declare(session, spec.key, CAPACITY)
        self._spec, self._frame, self._child = spec, frame_id, child_frame_id
        self._link, self._until_look = link, 0
        self._track = PoseTrack(link, child_frame_id)
        self.told: list[str] = []  # all warnings of the flight, oldest first
        self._taken = 0  # number of warnings that ``take_problems`` has returned
        self.refused = 0  # number of samples rejected here: unreadable, or of another type or frame

    def poll(self) -> list[RawSample]:
        """Return the usable samples that have arrived, oldest first, as odometry; never blocks."""
        taken: list[RawSample] = []
        for sample in zenoh_link.drain(self._subscriber):
            raw = raw_sample(sample)
            try:
                self._spec.check_key(str(sample.key_expr))
                made = self._odometry(raw.payload)
                if made is not None:
                    raw = raw._replace(payload=made.pack(), odometry=made)
            except OdometryError as error:
                self.refused += 1
                self._tell(str(error))
                continue
            if made is not None or self._spec.type is TargetType.ODOMETRY:
                taken.append(raw)
        return taken

    def take_problems(self) -> list[str]:
        """Return the warnings since the last call; each warning is sent once per flight."""
        texts, self._taken = self.told[self._taken :], len(self.told)
        return texts

    def _odometry(self, payload: bytes) -> Odometry | None:
        """Return the odometry made from a message; None: none yet, or the message needs no conversion."""
        if self._spec.type is not TargetType.ODOMETRY:
            return self._followed(self._spec.pose(payload))
        # Samples with a wrong frame are returned, too: the controller counts them, and the log stores them.
        if self._until_look == 0:
            self._until_look = LOOK_EVERY
            self._look_at(payload)
        self._until_look -= 1
        return None if self._spec.offset_m == ZERO else decode_odometry(payload).shifted(self._spec.offset_m)

    def _look_at(self, payload: bytes) -> None:
        """Report each difference between a sample's frames or noise and the configuration once."""
        try:
            odometry = decode_odometry(payload)
        except OdometryError:
            return  # the controller's decoder reports the error of each sample
        self._tell(self._frame_problem(odometry.frame_id))
        if odometry.child_frame_id != self._child:
            self._tell(
                f"child_frame_id is {odometry.child_frame_id!r}, "
                f"checks.target_child_frame is {self._child!r}: rejected; set it if this is the robot"
            )
        self._tell(excess_noise(odometry.pose_covariance, odometry.twist_covariance, self._link))

    def _followed(self, pose: Pose) -> Odometry | None:
        if problem := self._frame_problem(pose.frame_id):
            raise OdometryError(problem)
        self._tell(excess_noise(pose.covariance, NO_COVARIANCE, self._link))
        odometry = self._track.take(pose)
        self._tell(self._track.problem)
        return odometry

    def _frame_problem(self, frame_id: str) -> str:
        if frame_id == self._frame:
            return ""
        return (
            f"frame_id is {frame_id!r}, checks.target_frame is {self._frame!r}: rejected; "
            "set it only if that frame is the vehicle's east-north-up frame"
        )

    def _tell(self, problem: str) -> None:
        text = f"{self._spec.text}: {problem}"
        if problem and text not in self.told and len(self.told) < TEXTS_MAX:
            self.told.append(text)


KEYS_MAX = 8  # maximum number of listed keys
_CAPACITY = 64  # maximum number of samples between two polls
# A chunk of the key contains the name: robot1/odom, 0/odom/nav_msgs::msg::dds_::Odometry_/RIHS01_...
_LIKELY = ("**/$*odom$*/**", "**/$*Odometry$*/**", "**/$*pose$*/**", "**/$*Pose$*/**")


class KeySearch:
    """Lists keys whose names contain "odom" or "pose", from the first call of ``keys`` until ``stop``.

    During the search this process receives all samples of such keys, so do not use it in flight. Keys that
    the session itself publishes are not found.
    """

    def __init__(self, session: zenoh_link.Session) -> None:
        self._session = session
        self._subscribers: list[zenoh_link.Subscriber] = []
        self._found: dict[str, None] = {}

    def keys(self) -> tuple[str, ...]:
        """Return the sorted names found so far (rmw_zenoh: as ``ros2:/TOPIC``); the first call finds none."""
        if not self._subscribers:
            self._subscribers = [
                zenoh_link.remote_subscriber(self._session, key, _CAPACITY) for key in _LIKELY
            ]
        for subscriber in self._subscribers:
            for sample in zenoh_link.drain(subscriber):
                key = str(sample.key_expr)
                topic = parse_topic_key(key)
                if topic is not None:
                    key = f"ros2:{topic.topic} ({topic.type_name}, domain {topic.domain})"
                if len(self._found) < KEYS_MAX:
                    self._found[key] = None
        return tuple(sorted(self._found))

    def stop(self) -> None:
        """End the search and drop its results; may be called at any time."""
        for subscriber in self._subscribers:
            subscriber.undeclare()
        self._subscribers, self._found = [], {}
