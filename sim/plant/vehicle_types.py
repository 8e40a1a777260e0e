"""Estimated and true states of the simulated vehicle."""

from __future__ import annotations

from typing import Any, NamedTuple

from flightstack.core.types import Vec3


class Estimate(NamedTuple):
    """State estimate on board."""

    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # attitude (w, x, y, z) of body FLU in world ENU
    angular_velocity_flu_rad_s: Vec3
    valid: bool


class Truth(NamedTuple):
    """True state, and extremes and contacts since the last call of ``truth`` (fields of TrueState.msg)."""

    time_s: float
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: tuple[float, float, float, float]  # attitude (w, x, y, z) of body FLU in world ENU
    angular_velocity_flu_rad_s: Vec3
    rotor_rpm: tuple[float, float, float, float]
    pad_position_enu_m: Vec3
    pad_velocity_enu_m_s: Vec3
    pad_yaw_rad: float
    h_m: float
    h_min_m: float
    h_min_outside_pad_m: float  # smallest h outside the pad's radius; +inf if no step was outside
    contacts: int  # contacts since the last call of ``truth``, bits CONTACT_* of TrueState.msg
    first_touch_relative_position_enu_m: Vec3  # position at the first touch; NaN before it
    first_touch_relative_velocity_enu_m_s: Vec3
    first_touch_time_s: float  # time of the first touch; NaN before it
    motors_running: bool
    battery_v: float
    wind_enu_m_s: Vec3


TRUTH = 41  # number of values of a true state


def truth_of(row: Any) -> Truth:
    """Return the state with these ``TRUTH`` values in the order of its fields; columns give arrays."""
    return Truth(
        row[0], row[1:4], row[4:7], row[7:11], row[11:14], row[14:18], row[18:21], row[21:24], row[24],
        row[25], row[26], row[27], row[28], row[29:32], row[32:35], row[35], row[36], row[37], row[38:],
    )  # fmt: skip
