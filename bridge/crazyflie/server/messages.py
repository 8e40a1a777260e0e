"""Telemetry of a Crazyflie as MAVLink messages, each made from one state."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.crazyflie.modes import CODES
from bridge.crazyflie.types import CrazyflieState
from bridge.crazyflie.vehicle import Vehicle
from bridge.frames import euler_from_quaternion, frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from bridge.mavlink.codec.decoding import Message
from bridge.mavlink.profiles.autopilot_version import CRAZYFLIE_MARK

_M = dialect
_SENSORS = (
    _M.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | _M.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | _M.MAV_SYS_STATUS_SENSOR_3D_MAG
    | _M.MAV_SYS_STATUS_SENSOR_BATTERY
)
# There is no GPS indoors; but MAVSDK knows a position to be good by that bit alone (telemetry_impl.cpp).
_POSITION = _M.MAV_SYS_STATUS_SENSOR_GPS | _M.MAV_SYS_STATUS_SENSOR_VISION_POSITION
_CAPABILITIES = (
    _M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | _M.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    | _M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | _M.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | _M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_PX4_VERSION = 1 << 24 | 16 << 16 | 255  # 1.16.0, release: the PX4 whose codes are used


class View(NamedTuple):
    """What a message is made from."""

    vehicle: Vehicle
    state: CrazyflieState
    now_s: float


Builder = Callable[[View], Message]


def heartbeat(view: View) -> Message:
    """HEARTBEAT with PX4's modes and states (PX4 streams/HEARTBEAT.hpp)."""
    vehicle = view.vehicle
    code = CODES[vehicle.mode]
    if vehicle.armed:
        state = _M.MAV_STATE_CRITICAL if vehicle.failsafe else _M.MAV_STATE_ACTIVE
    else:
        state = _M.MAV_STATE_UNINIT if vehicle.problems(view.now_s) else _M.MAV_STATE_STANDBY
    base = code.base | (_M.MAV_MODE_FLAG_SAFETY_ARMED if vehicle.armed else 0)
    return _M.MAVLink_heartbeat_message(
        _M.MAV_TYPE_QUADROTOR, _M.MAV_AUTOPILOT_PX4, base, code.custom_mode, state, 3
    )


def _attitude(view: View) -> Message:
    state = view.state
    roll, pitch, yaw = euler_from_quaternion(ned_frd_from_enu_flu(state.quaternion))
    rates = frd_from_flu(state.rates_flu_rad_s)
    return _M.MAVLink_attitude_message(_boot_ms(state), roll, pitch, yaw, *rates)


def _attitude_quaternion(view: View) -> Message:
    state = view.state
    return _M.MAVLink_attitude_quaternion_message(
        _boot_ms(state), *ned_frd_from_enu_flu(state.quaternion), *frd_from_flu(state.rates_flu_rad_s)
    )


def _local_position_ned(view: View) -> Message:
    state = view.state
    return _M.MAVLink_local_position_ned_message(
        _boot_ms(state), *ned_from_enu(state.position_enu_m), *ned_from_enu(state.velocity_enu_m_s)
    )


def _sys_status(view: View) -> Message:
    vehicle = view.vehicle
    health = _SENSORS | (_POSITION if vehicle.position_known(view.now_s) else 0)
    ready = 0 if vehicle.problems(view.now_s) else _M.MAV_SYS_STATUS_PREARM_CHECK
    present = _SENSORS | _POSITION
    return _M.MAVLink_sys_status_message(
        present, present, health | ready, 0, _millivolts(view), -1, _percent(view), 0, 0, 0, 0, 0, 0
    )


def _extended_sys_state(view: View) -> Message:
    return _M.MAVLink_extended_sys_state_message(_M.MAV_VTOL_STATE_UNDEFINED, view.vehicle.landed_state)


def _battery_status(view: View) -> Message:
    voltages = [_millivolts(view)] + [0xFFFF] * 9  # one cell; the rest are not there
    return _M.MAVLink_battery_status_message(
        0,
        _M.MAV_BATTERY_FUNCTION_UNKNOWN,
        _M.MAV_BATTERY_TYPE_LIPO,
        0x7FFF,
        voltages,
        -1,
        -1,
        -1,
        _percent(view),
    )


def _home_position(view: View) -> Message:
    z = view.vehicle.home_z_m
    q = [1.0, 0.0, 0.0, 0.0]
    return _M.MAVLink_home_position_message(0, 0, round(1000 * z), 0.0, 0.0, -z, q, 0.0, 0.0, 0.0)


def _autopilot_version(view: View) -> Message:
    del view
    zeros = [0] * 8
    return _M.MAVLink_autopilot_version_message(
        _CAPABILITIES, _PX4_VERSION, 0, 0, 0, list(CRAZYFLIE_MARK), zeros, zeros, 0, 0, 0
    )


def _boot_ms(state: CrazyflieState) -> int:
    return state.boot_ms & 0xFFFFFFFF


def _millivolts(view: View) -> int:
    return min(max(round(1000 * view.state.battery_v), 0), 0xFFFE)


def _percent(view: View) -> int:
    health = view.vehicle.health
    return health.battery_percent if health is not None else -1


# Made from every new state, in this order: a position counts with the attitude that came before it.
# A position is sent only while the estimate may be flown by, as PX4 does.
PER_STATE: dict[int, Builder] = {
    _M.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
}
NEEDS_POSITION = frozenset({_M.MAVLINK_MSG_ID_LOCAL_POSITION_NED})
BY_TIME: dict[int, Builder] = {
    _M.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    _M.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
}
ON_REQUEST: dict[int, Builder] = {
    **PER_STATE,
    **BY_TIME,
    _M.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    _M.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
}
DEFAULT_S: dict[int, float] = {  # s between two; PX4's onboard link, where that makes sense here
    _M.MAVLINK_MSG_ID_ATTITUDE: 0.01,
    _M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 0.02,
    _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 0.01,
    _M.MAVLINK_MSG_ID_SYS_STATUS: 0.2,
    _M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    _M.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    _M.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
}
