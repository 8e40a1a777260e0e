"""Telemetry messages of the simulated autopilot, each made from one snapshot of the vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.decoding import Message
from bridge.frames import (
    Quat,
    body_from_world,
    frd_from_flu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
    yaw_ned_from_enu,
)
from flightstack.types import Vec3
from sim.autopilot_flight import Flight
from sim.autopilot_modes import CODES, EstimateLike

# The simulated room lies where PX4's SITL has its home (PX4 gz_bridge defaults), at sea level: clients differ
# in whether a take-off altitude counts from there or from home.
HOME_LATITUDE_DEG = 47.397742
HOME_LONGITUDE_DEG = 8.545594
_EARTH_RADIUS_M = 6_371_000.0  # PX4 geo.h
_EMPTY_CELL_V, _FULL_CELL_V = 3.0, 4.2  # V, one lithium polymer cell
_NAN = math.nan

_S = dialect
_SENSORS = (
    _S.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | _S.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | _S.MAV_SYS_STATUS_SENSOR_3D_MAG
    | _S.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | _S.MAV_SYS_STATUS_SENSOR_BATTERY
)
# Indoors there is none; but clients (MAVSDK telemetry_impl.cpp) know a position to be good only by this bit.
_POSITION_SOURCE = _S.MAV_SYS_STATUS_SENSOR_GPS | _S.MAV_SYS_STATUS_SENSOR_VISION_POSITION
_ESTIMATOR_FLAGS = (
    _S.ESTIMATOR_ATTITUDE
    | _S.ESTIMATOR_VELOCITY_HORIZ
    | _S.ESTIMATOR_VELOCITY_VERT
    | _S.ESTIMATOR_POS_HORIZ_REL
    | _S.ESTIMATOR_POS_HORIZ_ABS
    | _S.ESTIMATOR_POS_VERT_ABS
)
_CAPABILITIES = (
    _S.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | _S.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | _S.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | _S.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | _S.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | _S.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


@dataclass(slots=True)
class Snapshot:
    """What all messages of one moment are made from."""

    flight: Flight
    estimate: EstimateLike
    now_s: float
    epoch_ns: int  # Unix time of the boot clock's zero
    home_xy_m: tuple[float, float]

    @property
    def boot_ms(self) -> int:
        """Boot clock, ms."""
        return round(self.now_s * 1000) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """Boot clock, us."""
        return round(self.now_s * 1e6)

    @property
    def battery(self) -> float:
        """Charge left, 0 to 1, straight from the voltage."""
        share = (self.flight.vehicle.battery_v - _EMPTY_CELL_V) / (_FULL_CELL_V - _EMPTY_CELL_V)
        return min(max(share, 0.0), 1.0)


def heartbeat(flight: Flight) -> Message:
    """HEARTBEAT with PX4's modes and states (PX4 streams/HEARTBEAT.hpp)."""
    code = CODES[flight.mode]
    armed = flight.vehicle.armed
    if armed:
        state = dialect.MAV_STATE_CRITICAL if flight.failsafe else dialect.MAV_STATE_ACTIVE
    else:
        state = dialect.MAV_STATE_UNINIT if flight.problems() else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4,
        code.base | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0),
        code.custom_mode,
        state,
        3,
    )


def _sys_status(s: Snapshot) -> Message:
    present = _SENSORS | _POSITION_SOURCE
    health = _SENSORS | (_POSITION_SOURCE if s.estimate.valid else 0)
    ready = 0 if s.flight.problems() else dialect.MAV_SYS_STATUS_PREARM_CHECK
    return dialect.MAVLink_sys_status_message(
        present, present, health | ready, 0, _millivolts(s), -1, round(100 * s.battery), 0, 0, 0, 0, 0, 0
    )


def _extended_sys_state(s: Snapshot) -> Message:
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, s.flight.landed_state)


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
    x, y = s.home_xy_m
    latitude, longitude = _degrees_e7(x, y)
    position = ned_from_enu((x, y, 0.0))
    q = [1.0, 0.0, 0.0, 0.0]
    return dialect.MAVLink_home_position_message(
        latitude, longitude, 0, *position, q, 0.0, 0.0, 0.0, s.boot_us
    )


def _global_position_int(s: Snapshot) -> Message:
    x, y, z = s.estimate.position_enu_m
    height_mm = round(1000 * z)
    velocity_cm_s = (round(100 * v) for v in ned_from_enu(s.estimate.velocity_enu_m_s))
    heading = round(100 * _heading_deg(s)) % 36000
    return dialect.MAVLink_global_position_int_message(
        s.boot_ms, *_degrees_e7(x, y), height_mm, height_mm, *velocity_cm_s, heading
    )


def _gps_raw_int(s: Snapshot) -> Message:
    x, y, z = s.estimate.position_enu_m
    fix = dialect.GPS_FIX_TYPE_3D_FIX if s.estimate.valid else dialect.GPS_FIX_TYPE_NO_FIX
    vx, vy, _ = s.estimate.velocity_enu_m_s
    course = round(100 * math.degrees(math.atan2(vx, vy))) % 36000
    return dialect.MAVLink_gps_raw_int_message(
        s.boot_us, fix, *_degrees_e7(x, y), round(1000 * z), 10, 10,
        round(100 * math.hypot(vx, vy)), course, 12,
    )  # fmt: skip


def _battery_status(s: Snapshot) -> Message:
    voltages = [_millivolts(s)] + [0xFFFF] * 9  # one cell; the rest are not there
    unknown = dialect.MAV_BATTERY_FUNCTION_UNKNOWN
    return dialect.MAVLink_battery_status_message(
        0, unknown, dialect.MAV_BATTERY_TYPE_LIPO, 0x7FFF, voltages, -1, -1, -1, round(100 * s.battery)
    )


def _vfr_hud(s: Snapshot) -> Message:
    vx, vy, vz = s.estimate.velocity_enu_m_s
    speed, height = math.hypot(vx, vy), s.estimate.position_enu_m[2]
    return dialect.MAVLink_vfr_hud_message(speed, speed, round(_heading_deg(s)) % 360, 0, height, vz)


def _altitude(s: Snapshot) -> Message:
    z = s.estimate.position_enu_m[2]
    return dialect.MAVLink_altitude_message(s.boot_us, z, z, z, z, _NAN, _NAN)


def _estimator_status(s: Snapshot) -> Message:
    flags = _ESTIMATOR_FLAGS if s.estimate.valid else dialect.ESTIMATOR_ATTITUDE
    return dialect.MAVLink_estimator_status_message(
        s.boot_us, flags, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.01
    )


def _system_time(s: Snapshot) -> Message:
    return dialect.MAVLink_system_time_message(s.epoch_ns // 1000 + s.boot_us, s.boot_ms)


def _odometry(s: Snapshot) -> Message:
    e = s.estimate
    velocity = frd_from_flu(body_from_world(e.quaternion, e.velocity_enu_m_s))
    unknown = [_NAN] + [0.0] * 20  # NaN first: covariance not known
    return dialect.MAVLink_odometry_message(
        s.boot_us, dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_FRD,
        *ned_from_enu(e.position_enu_m), list(ned_frd_from_enu_flu(e.quaternion)), *velocity,
        *frd_from_flu(e.angular_velocity_flu_rad_s), unknown, unknown,
        0, dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
    )  # fmt: skip


def _position_target_local_ned(s: Snapshot) -> Message:
    wanted: Vec3 = s.flight.velocity_setpoint_enu_m_s or (_NAN, _NAN, _NAN)
    nan = (_NAN, _NAN, _NAN)
    return dialect.MAVLink_position_target_local_ned_message(
        s.boot_ms, dialect.MAV_FRAME_LOCAL_NED, 3527, *nan, *ned_from_enu(wanted), *nan, _NAN, _NAN
    )


def _gps_global_origin(s: Snapshot) -> Message:
    return dialect.MAVLink_gps_global_origin_message(*_degrees_e7(0.0, 0.0), 0, s.boot_us)


def _autopilot_version(s: Snapshot) -> Message:
    del s
    version = 1 << 24 | 16 << 16 | 255  # 1.16.0, release: the PX4 whose behaviour is copied
    zeros = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        _CAPABILITIES, version, 0, 0, 0, zeros, zeros, zeros, 0, 0, 0
    )


Builder = Callable[[Snapshot], Message]

BUILDERS: Mapping[int, Builder] = MappingProxyType(
    {
        dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
        dialect.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw_int,
        dialect.MAVLINK_MSG_ID_ATTITUDE: _attitude,
        dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
        dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
        dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position_int,
        dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _gps_global_origin,
        dialect.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: _position_target_local_ned,
        dialect.MAVLINK_MSG_ID_ALTITUDE: _altitude,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
        dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator_status,
        dialect.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
        dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    }
)


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


def _degrees_e7(x_m: float, y_m: float) -> tuple[int, int]:
    """Latitude and longitude in 1e-7 degrees of a point of the room, x east, y north."""
    latitude = HOME_LATITUDE_DEG + math.degrees(y_m / _EARTH_RADIUS_M)
    around_m = _EARTH_RADIUS_M * math.cos(math.radians(HOME_LATITUDE_DEG))
    return round(latitude * 1e7), round((HOME_LONGITUDE_DEG + math.degrees(x_m / around_m)) * 1e7)


def _millivolts(s: Snapshot) -> int:
    return min(max(round(1000 * s.flight.vehicle.battery_v), 0), 0xFFFE)
