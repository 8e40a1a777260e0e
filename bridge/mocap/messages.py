"""Poses from outside as MAVLink, and what differs between autopilots: one table.

Sources: PX4 mavlink_receiver.cpp and EKF2 (its estimator reads ODOMETRY of type VISION and
VISION_POSITION_ESTIMATE, not type MOCAP nor ATT_POS_MOCAP); ArduPilot GCS_Common.cpp (ODOMETRY in frame 20
alone, so VISION_POSITION_ESTIMATE) and AP_VisualOdom. Both take poses of a room whose axes are called north,
east and down.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import (
    euler_from_quaternion,
    ned_covariance_from_enu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    upper_triangle,
)
from bridge.mavlink.codec.decoding import Message
from bridge.mocap.checks import Passed

_UNKNOWN = (math.nan, *([0.0] * 20))  # NaN first: not known (MAVLink)
_NAN = math.nan


def _covariance(covariance: tuple[float, ...]) -> list[float]:
    known = any(covariance)  # all zero means unknown in ROS
    return list(upper_triangle(ned_covariance_from_enu(covariance)) if known else _UNKNOWN)


def vision_position_estimate(passed: Passed, time_us: int) -> Message:
    """VISION_POSITION_ESTIMATE: position in NED, roll, pitch and yaw of FRD in NED."""
    pose = passed.pose
    return dialect.MAVLink_vision_position_estimate_message(
        time_us,
        *ned_from_enu(pose.position_m),
        *euler_from_quaternion(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        _covariance(pose.covariance),
        passed.resets % 256,
    )


def odometry(passed: Passed, time_us: int) -> Message:
    """ODOMETRY of type VISION: pose of FRD in NED as a quaternion; velocities are not known."""
    pose = passed.pose
    return dialect.MAVLink_odometry_message(
        time_us,
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *ned_from_enu(pose.position_m),
        list(ned_frd_from_enu_flu(pose.orientation_wxyz)),
        *([_NAN] * 6),
        _covariance(pose.covariance),
        list(_UNKNOWN),
        passed.resets % 256,
        dialect.MAV_ESTIMATOR_TYPE_VISION,
    )


@dataclass(frozen=True, slots=True)
class Wants:
    """What an autopilot wants of poses from outside."""

    title: str
    message: Callable[[Passed, int], Message]
    rate_max_hz: float
    needs_origin: bool  # without SET_GPS_GLOBAL_ORIGIN it has no position
    settings: str  # its parameters, for a person


WANTS: Mapping[int, Wants] = MappingProxyType(
    {
        dialect.MAV_AUTOPILOT_PX4: Wants(
            "PX4",
            odometry,
            50.0,
            False,
            "EKF2_EV_CTRL 11, EKF2_HGT_REF 3, EKF2_GPS_CTRL 0, EKF2_MAG_TYPE 5",
        ),
        dialect.MAV_AUTOPILOT_ARDUPILOTMEGA: Wants(
            "ArduPilot",
            vision_position_estimate,
            50.0,
            True,
            "VISO_TYPE 1, GPS1_TYPE 0, EK3_SRC1_POSXY, EK3_SRC1_POSZ and EK3_SRC1_YAW 6",
        ),
    }
)
