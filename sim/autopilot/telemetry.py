"""Telemetry that only the simulated autopilot sends, and the room's WGS84 origin."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server import telemetry as common
from bridge.mavlink.server.telemetry import Snapshot, StreamTable
from flightstack.core.types import Vec3
from sim.autopilot.flight import Flight

ORIGIN_LATITUDE_DEG = 47.397742
ORIGIN_LONGITUDE_DEG = 8.545594
# latitude and longitude, degrees, height above sea level, m; ArduPilot treats a height of 0 as unknown
ORIGIN_WGS84 = (ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG, 10.0)
_EARTH_RADIUS_M = 6_371_000.0  # radius of the earth in PX4's geo.h
_AROUND_M = _EARTH_RADIUS_M * math.cos(math.radians(ORIGIN_LATITUDE_DEG))
_E7 = 1e7  # number of MAVLink's integer units per degree


def degrees_e7(x_m: float, y_m: float) -> tuple[int, int]:
    """Return latitude and longitude, 1e-7 degrees, of a point in the room (ENU, m)."""
    latitude = ORIGIN_LATITUDE_DEG + math.degrees(y_m / _EARTH_RADIUS_M)
    longitude = ORIGIN_LONGITUDE_DEG + math.degrees(x_m / _AROUND_M)
    return round(latitude * _E7), round(longitude * _E7)


_NAN = math.nan
_UNKNOWN_COVARIANCE = (_NAN,) + (0.0,) * 20  # a leading NaN means unknown
_ESTIMATOR_FLAGS = (
    dialect.ESTIMATOR_ATTITUDE
    | dialect.ESTIMATOR_VELOCITY_HORIZ
    | dialect.ESTIMATOR_VELOCITY_VERT
    | dialect.ESTIMATOR_POS_HORIZ_REL
    | dialect.ESTIMATOR_POS_HORIZ_ABS
    | dialect.ESTIMATOR_POS_VERT_ABS
)
_PWM_MIN_US, _PWM_SPAN_US = 1000, 1000  # idle pulse length, and range up to full speed, us; as in PX4's SITL


def _home_position(s: Snapshot[Flight]) -> Message:
    x, y, _ = s.vehicle.home_enu_m
    return common.home_position(s, *degrees_e7(x, y))


def _global_position_int(s: Snapshot[Flight]) -> Message:
    x, y, z = s.estimate.position_enu_m
    above_home_mm = round(1000 * (z - s.vehicle.home_enu_m[2]))
    velocity_cm_s = (round(100 * v) for v in ned_from_enu(s.estimate.velocity_enu_m_s))
    heading = round(100 * common.heading_deg(s)) % 36000
    return dialect.MAVLink_global_position_int_message(
        s.boot_ms, *degrees_e7(x, y), round(1000 * z), above_home_mm, *velocity_cm_s, heading
    )


def _gps_raw_int(s: Snapshot[Flight]) -> Message:
    x, y, z = s.estimate.position_enu_m
    fix = dialect.GPS_FIX_TYPE_3D_FIX if s.valid else dialect.GPS_FIX_TYPE_NO_FIX
    vx, vy, _ = s.estimate.velocity_enu_m_s
    course = round(100 * math.degrees(math.atan2(vx, vy))) % 36000
    return dialect.MAVLink_gps_raw_int_message(
        s.boot_us, fix, *degrees_e7(x, y), round(1000 * z), 10, 10,
        round(100 * math.hypot(vx, vy)), course, 12,
    )  # fmt: skip


def _vfr_hud(s: Snapshot[Flight]) -> Message:
    return common.vfr_hud(s, round(25 * sum(s.vehicle.vehicle.duty)))


def _altitude(s: Snapshot[Flight]) -> Message:
    z = s.estimate.position_enu_m[2]
    above_home_m = z - s.vehicle.home_enu_m[2]
    return dialect.MAVLink_altitude_message(s.boot_us, z, z, z, above_home_m, _NAN, _NAN)


def _odometry(s: Snapshot[Flight]) -> Message:
    # The velocity is in world axes, as PX4 1.16 sends it (measured: frame_id = child_frame_id = 1): the
    # velocity of PX4's estimator is NED (PX4 streams/ODOMETRY.hpp, EKF2.cpp).
    e = s.estimate
    return dialect.MAVLink_odometry_message(
        s.boot_us, dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_LOCAL_NED,
        *ned_from_enu(e.position_enu_m), list(ned_frd_from_enu_flu(e.quaternion)),
        *ned_from_enu(e.velocity_enu_m_s), *frd_from_flu(e.angular_velocity_flu_rad_s),
        _UNKNOWN_COVARIANCE, _UNKNOWN_COVARIANCE, 0, dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )  # fmt: skip


def _position_target_local_ned(s: Snapshot[Flight]) -> Message:
    wanted: Vec3 = s.vehicle.pilot.velocity_setpoint_enu_m_s or (_NAN, _NAN, _NAN)
    nan = (_NAN, _NAN, _NAN)
    return dialect.MAVLink_position_target_local_ned_message(
        s.boot_ms, dialect.MAV_FRAME_LOCAL_NED, 3527, *nan, *ned_from_enu(wanted), *nan, _NAN, _NAN
    )


def _gps_global_origin(s: Snapshot[Flight]) -> Message:
    return dialect.MAVLink_gps_global_origin_message(*degrees_e7(0.0, 0.0), 0, s.boot_us)


def _estimator_status(s: Snapshot[Flight]) -> Message:
    flags = _ESTIMATOR_FLAGS if s.valid else dialect.ESTIMATOR_ATTITUDE
    return dialect.MAVLink_estimator_status_message(
        s.boot_us, flags, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.01
    )


def _servo_output_raw(s: Snapshot[Flight]) -> Message:
    pulses_us = [_PWM_MIN_US + round(_PWM_SPAN_US * c) for c in s.vehicle.vehicle.motor_commands]
    return dialect.MAVLink_servo_output_raw_message(s.boot_us & 0xFFFFFFFF, 0, *pulses_us, 0, 0, 0, 0)


def _system_time(s: Snapshot[Flight]) -> Message:
    return dialect.MAVLink_system_time_message(s.epoch_ns // 1000 + s.boot_us, s.boot_ms)


# Streams in the order of a datagram. The default rates, Hz, are those of PX4, or rates that clients needed in
# measurements. None: a message in ``EVERY_TICK`` is sent at every tick, all others on request only.
STREAMS: StreamTable[Flight] = {
    dialect.MAVLINK_MSG_ID_SYS_STATUS: (common.sys_status, 5.0),
    dialect.MAVLINK_MSG_ID_SYSTEM_TIME: (_system_time, 1.0),
    dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: (_servo_output_raw, 1.0),
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: (common.battery_status, 0.5),
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: (_estimator_status, 0.5),
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: (common.extended_sys_state, 5.0),
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: (_gps_raw_int, 1.0),
    dialect.MAVLINK_MSG_ID_ATTITUDE: (common.attitude, None),
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (common.attitude_quaternion, 10.0),
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (common.local_position_ned, None),
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (_global_position_int, 5.0),
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: (_gps_global_origin, None),
    dialect.MAVLINK_MSG_ID_VFR_HUD: (_vfr_hud, 2.0),
    dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: (_position_target_local_ned, 2.0),
    dialect.MAVLINK_MSG_ID_ALTITUDE: (_altitude, 1.0),
    dialect.MAVLINK_MSG_ID_HOME_POSITION: (_home_position, 0.5),
    dialect.MAVLINK_MSG_ID_ODOMETRY: (_odometry, 5.0),  # PX4's onboard link has 30 Hz; packing is slow here
}
