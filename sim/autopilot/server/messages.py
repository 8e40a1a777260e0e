"""Telemetry of position and motion, each message made from one snapshot; and the table of all telemetry."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import (
    Quat,
    frd_from_flu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
    yaw_ned_from_enu,
)
from bridge.mavlink.codec.decoding import Message
from flightstack.core.types import Vec3
from sim.autopilot.geo import degrees_e7
from sim.autopilot.server.snapshot import Builder, Snapshot
from sim.autopilot.server.status import ON_REQUEST, STATUS

_NAN = math.nan
_UNKNOWN_COVARIANCE = (_NAN,) + (0.0,) * 20  # NaN first: not known


def _local_position_ned(s: Snapshot) -> Message:
    x, y, z = ned_from_enu(s.estimate.position_enu_m)
    vx, vy, vz = ned_from_enu(s.estimate.velocity_enu_m_s)
    return dialect.MAVLink_local_position_ned_message(s.boot_ms, x, y, z, vx, vy, vz)


def _attitude(s: Snapshot) -> Message:
    rates = frd_from_flu(s.estimate.angular_velocity_flu_rad_s)
    return dialect.MAVLink_attitude_message(s.boot_ms, *_euler(s.estimate.quaternion), *rates)


def _attitude_quaternion(s: Snapshot) -> Message:
    rates = frd_from_flu(s.estimate.angular_velocity_flu_rad_s)
    return dialect.MAVLink_attitude_quaternion_message(
        s.boot_ms, *ned_frd_from_enu_flu(s.estimate.quaternion), *rates
    )


def _home_position(s: Snapshot) -> Message:
    x, y, z = s.flight.home_enu_m
    q = [1.0, 0.0, 0.0, 0.0]
    return dialect.MAVLink_home_position_message(
        *degrees_e7(x, y), round(1000 * z), *ned_from_enu((x, y, z)), q, 0.0, 0.0, 0.0, s.boot_us
    )


def _global_position_int(s: Snapshot) -> Message:
    x, y, z = s.estimate.position_enu_m
    above_home_mm = round(1000 * (z - s.flight.home_enu_m[2]))
    velocity_cm_s = (round(100 * v) for v in ned_from_enu(s.estimate.velocity_enu_m_s))
    heading = round(100 * _heading_deg(s)) % 36000
    return dialect.MAVLink_global_position_int_message(
        s.boot_ms, *degrees_e7(x, y), round(1000 * z), above_home_mm, *velocity_cm_s, heading
    )


def _gps_raw_int(s: Snapshot) -> Message:
    x, y, z = s.estimate.position_enu_m
    fix = dialect.GPS_FIX_TYPE_3D_FIX if s.estimate.valid else dialect.GPS_FIX_TYPE_NO_FIX
    vx, vy, _ = s.estimate.velocity_enu_m_s
    course = round(100 * math.degrees(math.atan2(vx, vy))) % 36000
    return dialect.MAVLink_gps_raw_int_message(
        s.boot_us, fix, *degrees_e7(x, y), round(1000 * z), 10, 10,
        round(100 * math.hypot(vx, vy)), course, 12,
    )  # fmt: skip


def _vfr_hud(s: Snapshot) -> Message:
    vx, vy, vz = s.estimate.velocity_enu_m_s
    speed, height = math.hypot(vx, vy), s.estimate.position_enu_m[2]
    return dialect.MAVLink_vfr_hud_message(speed, speed, round(_heading_deg(s)) % 360, 0, height, vz)


def _altitude(s: Snapshot) -> Message:
    z = s.estimate.position_enu_m[2]
    above_home_m = z - s.flight.home_enu_m[2]
    return dialect.MAVLink_altitude_message(s.boot_us, z, z, z, above_home_m, _NAN, _NAN)


def _odometry(s: Snapshot) -> Message:
    # The velocity is in the world's axes: so PX4 1.16's own ODOMETRY was measured (frame_id = child_frame_id
    # = 1), since its estimator's velocity is NED (PX4 streams/ODOMETRY.hpp, EKF2.cpp).
    e = s.estimate
    return dialect.MAVLink_odometry_message(
        s.boot_us, dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_NED,
        *ned_from_enu(e.position_enu_m), list(ned_frd_from_enu_flu(e.quaternion)),
        *ned_from_enu(e.velocity_enu_m_s), *frd_from_flu(e.angular_velocity_flu_rad_s),
        _UNKNOWN_COVARIANCE, _UNKNOWN_COVARIANCE, 0, dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )  # fmt: skip


def _position_target_local_ned(s: Snapshot) -> Message:
    wanted: Vec3 = s.flight.pilot.velocity_setpoint_enu_m_s or (_NAN, _NAN, _NAN)
    nan = (_NAN, _NAN, _NAN)
    return dialect.MAVLink_position_target_local_ned_message(
        s.boot_ms, dialect.MAV_FRAME_LOCAL_NED, 3527, *nan, *ned_from_enu(wanted), *nan, _NAN, _NAN
    )


def _gps_global_origin(s: Snapshot) -> Message:
    return dialect.MAVLink_gps_global_origin_message(*degrees_e7(0.0, 0.0), 0, s.boot_us)


BUILDERS: Mapping[int, Builder] = MappingProxyType(  # what can be streamed
    {
        **STATUS,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw_int,
        dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
        dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position_int,
        dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _gps_global_origin,
        dialect.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target_local_ned,
        dialect.MAVLINK_MSG_ID_ALTITUDE: _altitude,
        dialect.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
        dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    }
)
REQUESTABLE: Mapping[int, Builder] = MappingProxyType({**BUILDERS, **ON_REQUEST})


def _euler(q_enu_flu: Quat) -> Vec3:
    """Roll, pitch and yaw of FRD in NED, radians (MAVLink ATTITUDE)."""
    w, x, y, z = ned_frd_from_enu_flu(q_enu_flu)
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x)))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def _heading_deg(s: Snapshot) -> float:
    """Heading clockwise from north, 0 to 360."""
    return math.degrees(yaw_ned_from_enu(yaw_from_quaternion(s.estimate.quaternion))) % 360.0
