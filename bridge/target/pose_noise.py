"""Compares the covariances that a sender reports with the configured noise.

Covariances of ROS messages: 6 x 6, row by row, x y z then roll pitch yaw; all zero means unknown
(nav_msgs/msg/Odometry, REP 103), and a first element of -1 that there is none (sensor_msgs practice).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.parameters.robust import TargetLink

TOLD_FACTOR = 1.5  # a sender that is so much worse than configured is worth a word
_UNUSED_M2 = 1e3  # diff_drive_controller and others write 1e6 where nothing is measured


class MeasurementNoise(NamedTuple):
    """Standard deviations of a sample, the larger of x and y; ``None`` if the sender does not report it."""

    position_m: float | None
    velocity_m_s: float | None


def noise_of(pose_covariance: Sequence[float], twist_covariance: Sequence[float]) -> MeasurementNoise:
    """Read position and linear velocity out of two covariances of 36 numbers."""
    return MeasurementNoise(
        sigma_of(pose_covariance[0], pose_covariance[7]), sigma_of(twist_covariance[0], twist_covariance[7])
    )


def sigma_of(variance_x: float, variance_y: float) -> float | None:
    """Return the larger standard deviation of x and y, ``None`` if the sender does not report it."""
    known = 0.0 < variance_x < _UNUSED_M2 and 0.0 < variance_y < _UNUSED_M2  # False for NaN
    return math.sqrt(max(variance_x, variance_y)) if known else None


def worse_than_told(noise: MeasurementNoise, link: TargetLink) -> str:
    """Return a warning if the sender reports more noise than the configuration, else nothing."""
    found: list[str] = []
    for sigma, told, name, unit in (
        (noise.position_m, link.position_noise_m, "position_noise_m", "m"),
        (noise.velocity_m_s, link.velocity_noise_m_s, "velocity_noise_m_s", "m/s"),
    ):
        if sigma is not None and sigma > TOLD_FACTOR * told:
            found.append(f"{sigma:.3g} {unit} where target.{name} is {told:g}")
    if not found:
        return ""
    return (
        f"its covariance says {' and '.join(found)}: flown with larger margins; configure what it says, the "
        "certificate counts that"
    )
