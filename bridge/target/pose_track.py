"""Estimates the velocity of targets that send poses only: poses in, odometry out.

The velocity is that of the stack's own target estimator (position and velocity measured) with the
velocity measured so badly that it says nothing. Nothing goes on before the estimate has settled, none of
an outlier; what goes on is the pose as it was measured, with that velocity, in the form of any other target.
"""

from __future__ import annotations

import math
from dataclasses import replace

from bridge.frames import body_from_world, body_from_world_velocity, wrap_angle, yaw_from_quaternion
from bridge.ros2.cdr import Odometry, Pose
from flightstack.core.parameters.robust import TargetLink
from flightstack.core.target.estimator import RESTART_S, TargetEstimator
from flightstack.core.types import ZERO

SETTLED_M_S = (
    0.05  # standard deviation of the velocity at which it may be flown by; a quarter of the Burger's
)
UNKNOWN_M_S = 100.0  # standard deviation of the velocity "measured" as zero: no robot is near it
GATE_SIGMAS = 6.0  # a pose further from the expected one is an outlier: 1 in 10^8 by chance
OUTLIERS_MAX = 5  # in a row: then it is there, and all begins anew
UNSETTLED_MAX = 50  # poses without a velocity after which it is said


class PoseTrack:
    """Turns poses of one target into odometry.

    ``link``: noise of the poses and of the target's motion, as for the flight's own filter;
    ``child_frame_id``: what the target is to be called in the odometry.
    """

    def __init__(self, link: TargetLink, child_frame_id: str) -> None:
        self._estimator = TargetEstimator(replace(link, velocity_noise_m_s=UNKNOWN_M_S))
        self._noise_m, self._child = link.position_noise_m, child_frame_id
        self._last: Pose | None = None  # believed
        self._outliers = 0
        self._unsettled = 0  # poses since all began anew
        self.problem = ""  # why so many are withheld, "" when they are not
        self.withheld = 0  # poses that made no odometry: unsettled, outliers, repeated or out of order

    def take(self, pose: Pose) -> Odometry | None:
        """Take a pose; returns its odometry, or ``None`` while the velocity is not known."""
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
            if last is not None and -RESTART_S <= step_s < 0.0:
                return None  # out of order; further back the sender's clock began anew
            self._estimator.memory.time_s = math.nan
            last = None
        self._outliers, self._last = 0, pose
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
                    "target.jerk_xy_m_s3_sqrthz lower if that is true; none goes on"
                )
            return None
        self.problem = ""
        # Between two poses, unfiltered: it is recorded, nothing flies by it.
        turned_rad = wrap_angle(yaw_rad - yaw_from_quaternion(last.orientation_wxyz))
        return Odometry(
            pose.stamp_ns,
            pose.frame_id,
            self._child,
            pose.position_m,
            q,
            body_from_world_velocity(q, motion.velocity_enu_m_s),
            body_from_world(q, (0.0, 0.0, turned_rad / step_s)),
            pose.covariance,
        )

    def _is_outlier(self, pose: Pose, time_s: float) -> bool:
        expected = self._estimator.at(time_s)
        allowed_m = GATE_SIGMAS * math.hypot(expected.position_sigma_m, self._noise_m)
        return not math.dist(pose.position_m, expected.position_enu_m) <= allowed_m  # also where it is NaN
