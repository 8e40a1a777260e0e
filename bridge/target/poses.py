"""Converts poses of a target without a velocity into odometry."""

from __future__ import annotations

import math
from dataclasses import replace

from bridge.frames import body_from_world, wrap_angle, yaw_from_quaternion
from bridge.ros2.cdr import Odometry, Pose
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import RESTART_S, TargetEstimator
from flightstack.core.types import ZERO

SETTLED_M_S = 0.05  # greatest standard deviation of a usable velocity; a quarter of the Burger's
UNKNOWN_M_S = 100.0  # standard deviation of a velocity that was not measured, far above robot speeds
GATE_SIGMAS = 6.0  # distance from the expected pose that makes an outlier: 1 in 10^8 by chance
# outliers, or poses behind the newest stamp, in a row after which the estimate restarts with them
OUTLIERS_MAX = 5
UNSETTLED_MAX = 50  # poses without a velocity after which a warning is sent


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
