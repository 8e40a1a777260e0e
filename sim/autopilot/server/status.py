"""Messages about the vehicle's condition: mode, health, battery, motors, version, time."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.profiles.autopilot_version import SITL_MARK
from sim.autopilot.flight import Flight
from sim.autopilot.server.snapshot import Builder, Snapshot

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
_FENCE = (
    _S.MAV_SYS_STATUS_GEOFENCE
)  # healthy also when none is set, as with PX4: MAVProxy calls a breach else
_ESTIMATOR_FLAGS = (
    _S.ESTIMATOR_ATTITUDE
    | _S.ESTIMATOR_VELOCITY_HORIZ
    | _S.ESTIMATOR_VELOCITY_VERT
    | _S.ESTIMATOR_POS_HORIZ_REL
    | _S.ESTIMATOR_POS_HORIZ_ABS
    | _S.ESTIMATOR_POS_VERT_ABS
)
_PWM_MIN_US, _PWM_SPAN_US = 1000, 1000  # us; what PX4's SITL reports for an idle and a full motor


def heartbeat(flight: Flight) -> Message:
    """HEARTBEAT with the personality's modes, and PX4's states (PX4 streams/HEARTBEAT.hpp)."""
    code = flight.personality.codes[flight.mode]
    armed = flight.vehicle.armed
    if armed:
        state = dialect.MAV_STATE_CRITICAL if flight.failsafe else dialect.MAV_STATE_ACTIVE
    else:
        state = dialect.MAV_STATE_UNINIT if flight.problems() else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        flight.personality.autopilot,
        code.base | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0),
        flight.personality.custom_mode(code),
        state,
        3,
    )


def _sys_status(s: Snapshot) -> Message:
    present = _SENSORS | _POSITION_SOURCE
    outside = s.flight.watches.outside(s.estimate.position_enu_m, s.flight.home_enu_m)
    health = _SENSORS | (_POSITION_SOURCE if s.flight.positioned else 0) | (0 if outside else _FENCE)
    ready = 0 if s.flight.problems() else dialect.MAV_SYS_STATUS_PREARM_CHECK
    return dialect.MAVLink_sys_status_message(
        present, present, health | ready, 0, _millivolts(s), -1, _percent(s), 0, 0, 0, 0, 0, 0
    )


def _extended_sys_state(s: Snapshot) -> Message:
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, s.flight.landed_state)


def _battery_status(s: Snapshot) -> Message:
    voltages = [_millivolts(s)] + [0xFFFF] * 9  # one cell; the rest are not there
    unknown = dialect.MAV_BATTERY_FUNCTION_UNKNOWN
    level = s.flight.watches.battery.level
    return dialect.MAVLink_battery_status_message(
        0, unknown, dialect.MAV_BATTERY_TYPE_LIPO, 0x7FFF, voltages, -1, -1, -1, _percent(s), 0, level
    )


def _estimator_status(s: Snapshot) -> Message:
    flags = _ESTIMATOR_FLAGS if s.estimate.valid else dialect.ESTIMATOR_ATTITUDE
    return dialect.MAVLink_estimator_status_message(
        s.boot_us, flags, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.01
    )


def _servo_output_raw(s: Snapshot) -> Message:
    pulses_us = [_PWM_MIN_US + round(_PWM_SPAN_US * c) for c in s.flight.vehicle.motor_commands]
    return dialect.MAVLink_servo_output_raw_message(s.boot_us & 0xFFFFFFFF, 0, *pulses_us, 0, 0, 0, 0)


def _system_time(s: Snapshot) -> Message:
    return dialect.MAVLink_system_time_message(s.epoch_ns // 1000 + s.boot_us, s.boot_ms)


def _heartbeat(s: Snapshot) -> Message:
    return heartbeat(s.flight)


def _autopilot_version(s: Snapshot) -> Message:
    who, zeros = s.flight.personality, [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        who.capabilities, who.version, 0, 0, 0, list(SITL_MARK), zeros, zeros, 0, 0, 0
    )


def _percent(s: Snapshot) -> int:
    return round(100 * s.flight.watches.battery.remaining)


def _millivolts(s: Snapshot) -> int:
    return min(max(round(1000 * s.flight.vehicle.battery_v), 0), 0xFFFE)


STATUS: Mapping[int, Builder] = MappingProxyType(
    {
        dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
        dialect.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
        dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output_raw,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator_status,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    }
)
ON_REQUEST: Mapping[int, Builder] = MappingProxyType(  # sent when asked for, no streams, as in PX4
    {
        dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
        dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    }
)
