"""Poses of motion capture to a Crazyflie: each as one packet, and its estimator begun where the body is.

The firmware corrects attitude by a small angle only (mm_pose.c): begun with the nose in another direction,
its estimate may never come round. So it is started at the first good pose, and again when it was carried.
"""

from __future__ import annotations

from typing import Protocol

from bridge.crazyflie.checks import ESTIMATOR, KALMAN
from bridge.crazyflie.types import Link, Packet, Pose, SetParam
from bridge.frames import yaw_from_quaternion
from bridge.mocap.checks import Passed

INITIAL = "kalman.initial"
RESET = "kalman.resetEstimation"


class PosesLike(Protocol):
    """Poses that have been checked; ``mocap_source.CheckedPoses``."""

    @property
    def problem(self) -> str | None:
        """Why there is no pose to rely on, None while there is."""

    def poll(self, now_s: float, *, armed: bool) -> Passed | None:
        """The newest good pose since the last call."""


class PoseFeed:
    """What to send for a pose."""

    def __init__(self) -> None:
        self._begun: tuple[int, int] | None = None  # which link and series the estimator was started with

    def packets(self, passed: Passed, link: Link, *, armed: bool) -> list[Packet]:
        """Packets of one pose; nothing without a link.

        Args:
            passed: the pose.
            link: what is known of the firmware; another object is another connection.
            armed: the motors may run: then the estimator is left alone.
        """
        if link.protocol is None:
            return []
        pose = Pose(passed.pose.position_m, passed.pose.orientation_wxyz)
        key = (id(link), passed.resets)
        if armed or self._begun == key or link.params.get(ESTIMATOR) != KALMAN:
            return [pose]
        self._begun = key
        x, y, z = pose.position_enu_m
        values = {"X": x, "Y": y, "Z": z, "Yaw": yaw_from_quaternion(pose.quaternion)}
        start = [SetParam(INITIAL + name, value) for name, value in values.items()]
        return [*start, SetParam(RESET, 1.0), SetParam(RESET, 0.0), pose]
