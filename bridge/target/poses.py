"""Poses of a target without a velocity: as odometry, and from a chain of transforms."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

from bridge.frames import Quat, body_from_world, wrap_angle, yaw_from_quaternion
from bridge.ros2.cdr import Odometry, Pose, Transform
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import RESTART_S, TargetEstimator
from flightstack.core.types import ZERO

SETTLED_M_S = 0.05  # greatest standard deviation of a usable velocity; a quarter of the Burger's
UNKNOWN_M_S = 100.0  # standard deviation of a velocity that was not measured, far above robot speeds
GATE_SIGMAS = 6.0  # distance from the expected pose that makes an outlier: 1 in 10^8 by chance
# outliers, or poses behind the newest stamp, in a row after which the estimate restarts with them
OUTLIERS_MAX = 5
UNSETTLED_MAX = 50  # poses without a velocity after which a warning is sent
EDGE_AGE_MAX_S = 1.0  # s; AMCL sends map -> odom at the rate of the laser, 5 Hz on a TurtleBot3
FRAMES_MAX = 256  # further frames are ignored
DEPTH_MAX = 16  # greatest number of edges from the tracked frame to the world frame


class PoseTrack:
    """Converts poses of a target into odometry of ``child_frame_id`` by estimating the velocity.

    The estimator is the stack's (it measures position and velocity), with so large a velocity noise that the
    measured velocity has no influence. Odometry is the measured pose with the estimated velocity; there is
    none before the estimate has settled, and none for an outlier. ``link``: noise of poses and motion.
    """

    def __init__(self, link: TargetLink, child_frame_id: str) -> None:
        self._estimator = TargetEstimator(replace(link, velocity_noise_m_s=UNKNOWN_M_S))
        self._noise_m, self._child = link.position_noise_m, child_frame_id
        self._last: Pose | None = None  # last accepted pose
        self._outliers = 0
        self._behind, self._behind_ns = 0, 0  # poses in a row behind the newest stamp; the last one's stamp
        self._unsettled = 0  # poses since the last restart
        self.problem = ""  # reason why poses are withheld, or ""
        self.withheld = 0  # number of poses without odometry: unsettled, outliers, repeated or out of order

    def take(self, pose: Pose) -> Odometry | None:
        """Return the odometry of a pose; None if the velocity is unknown."""
        odometry = self._take(pose)
        self.withheld += odometry is None
        return odometry

    def _take(self, pose: Pose) -> Odometry | None:
        time_s, last = pose.stamp_ns / 1e9, self._last
        step_s = (pose.stamp_ns - last.stamp_ns) / 1e9 if last is not None else math.inf
        if last is not None and 0.0 < step_s <= RESTART_S and self._is_outlier(pose, time_s):
            self._outliers += 1
            if self._outliers < OUTLIERS_MAX:
                return None
            step_s = math.inf
        if step_s == 0.0:
            return None
        if not 0.0 < step_s <= RESTART_S:
            if last is not None and -RESTART_S <= step_s < 0.0 and not self._continues(pose.stamp_ns):
                return None  # out of order; a greater step back is a restart of the sender's clock
            self._estimator.memory.time_s = math.nan
            last = None
        self._outliers, self._behind, self._last = 0, 0, pose
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
        # Yaw rate between two poses, unfiltered; only the log uses it.
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

    def _continues(self, stamp_ns: int) -> bool:
        """Whether several poses in order are behind the newest stamp: that stamp was wrong."""
        self._behind = self._behind + 1 if self._behind and stamp_ns > self._behind_ns else 1
        self._behind_ns = stamp_ns
        return self._behind >= OUTLIERS_MAX

    def _is_outlier(self, pose: Pose, time_s: float) -> bool:
        expected = self._estimator.at(time_s)
        allowed_m = GATE_SIGMAS * math.hypot(expected.position_sigma_m, self._noise_m)
        return not math.dist(pose.position_m, expected.position_enu_m) <= allowed_m  # NaN is an outlier, too


class TransformChain:
    """Pose of the frame ``child_frame_id`` in ``frame_id`` from single transforms, as on ROS 2's ``/tf``.

    Each new transform of the tracked frame gives a pose at its stamp; if the frame is fixed to another frame
    (``/tf_static``), each new transform of that frame does. The newest transforms of the frames above are
    used. They must be fixed, or at most ``EDGE_AGE_MAX_S`` older: after a failure of the localisation the
    wheel odometry must not be used alone.
    """

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        self._frame, self._child = frame_id, child_frame_id
        self._edges: dict[str, Pose] = {}  # pose in the parent frame, by child frame
        self._fixed: dict[str, Pose] = {}  # fixed pose in the parent frame, from ``/tf_static``
        self.problem = f"no transform of {child_frame_id!r} yet"  # reason why there is no pose, or ""

    def take_fixed(self, transforms: Iterable[Transform]) -> None:
        for transform in transforms:
            child, edge = _without_slash(transform)
            _keep(self._fixed, child, edge, child == self._child)

    def take(self, transforms: Iterable[Transform]) -> list[Pose]:
        """Use the transforms of one message; return the new poses, oldest first."""
        taken = [_without_slash(transform) for transform in transforms]
        for child, edge in taken:
            _keep(self._edges, child, edge, child == self._child)
        carrier, place = self._carrier()
        poses: list[Pose] = []
        for child, edge in taken:
            if child == carrier:
                there = edge if place is None else _compose(edge, place._replace(stamp_ns=edge.stamp_ns))
                pose = self._climb(there)
                if pose is not None:
                    poses.append(pose)
        if not poses and carrier not in self._edges:
            self.problem = f"no transform of {carrier!r} yet"
            if carrier != self._child:
                self.problem += f", to which {self._child!r} is fixed"
        return poses

    def _carrier(self) -> tuple[str, Pose | None]:
        """Return the nearest frame above (or itself) that is not fixed to another, and the pose in it."""
        frame, place = self._child, None
        for _ in range(DEPTH_MAX):
            fixed = self._fixed.get(frame)
            if fixed is None or frame in self._edges:
                break
            frame, place = fixed.frame_id, fixed if place is None else _compose(fixed, place)
        return frame, place

    def _climb(self, pose: Pose) -> Pose | None:
        for _ in range(DEPTH_MAX):
            if pose.frame_id == self._frame:
                self.problem = ""
                return pose
            above = self._edges.get(pose.frame_id)
            if above is None:
                fixed = self._fixed.get(pose.frame_id)
                if fixed is not None:
                    pose = _compose(fixed, pose)
                    continue
                self.problem = (
                    f"{self._child!r} is known in {pose.frame_id!r}, but there is no transform from that to "
                    f"{self._frame!r}"
                )
                return None
            age_s = (pose.stamp_ns - above.stamp_ns) / 1e9
            if age_s > EDGE_AGE_MAX_S:
                self.problem = (
                    f"the transform of {pose.frame_id!r} in {above.frame_id!r} is {age_s:.1f} s older than "
                    f"that of {self._child!r}: at most {EDGE_AGE_MAX_S:g} s are allowed"
                )
                return None
            pose = _compose(above, pose)
        self.problem = f"{self._child!r} is more than {DEPTH_MAX} transforms below, or they form a circle"
        return None


def _without_slash(transform: Transform) -> tuple[str, Pose]:
    """Return the transform's frame name without the leading slash of ROS 1's tf, and its pose."""
    pose = transform.pose
    return transform.child_frame_id.removeprefix("/"), pose._replace(frame_id=pose.frame_id.removeprefix("/"))


def _keep(edges: dict[str, Pose], child: str, edge: Pose, always: bool) -> None:
    if always or child in edges or len(edges) < FRAMES_MAX:
        edges[child] = edge


def _compose(above: Pose, pose: Pose) -> Pose:
    """Return a pose in the parent frame of ``above``, with the stamp of ``pose``."""
    turned = _product(above.orientation_wxyz, pose.orientation_wxyz)
    return above.shifted(pose.position_m)._replace(stamp_ns=pose.stamp_ns, orientation_wxyz=turned)


def _product(a: Quat, b: Quat) -> Quat:
    """Return the rotation ``b`` followed by ``a`` (Hamilton product)."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
