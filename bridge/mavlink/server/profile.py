"""PX4's modes and capabilities that this project's vehicles imitate.

The constants are from PX4 1.18 (``px4_custom_mode.h``, ``Commander.cpp``, ``mavlink_receiver.cpp``).
``bridge.mavlink.profiles`` describes how the flight stack uses an autopilot.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

_M = dialect


class FlightMode(Enum):
    HOLD = "hold"
    TAKEOFF = "take-off"
    LAND = "land"
    OFFBOARD = "offboard"


class Code(NamedTuple):
    """Numbers of a mode in MAVLink messages."""

    main: int  # PX4_CUSTOM_MAIN_MODE number (px4_custom_mode.h)
    sub: int  # PX4_CUSTOM_SUB_MODE_AUTO number
    base: int  # MAV_MODE_FLAG bits of a disarmed vehicle

    @property
    def custom_mode(self) -> int:
        """PX4's ``custom_mode`` of HEARTBEAT and SET_MODE."""
        return self.main << 16 | self.sub << 24


_AUTO = 1 | 4 | 8 | 16  # bits custom, auto, guided, stabilised (PX4 streams/HEARTBEAT.hpp)
_EXTERNAL = 1 | 16  # bits custom and stabilised only: PX4 does not count OFFBOARD as an auto mode

PX4_CODES: Mapping[FlightMode, Code] = {
    FlightMode.HOLD: Code(4, 3, _AUTO),  # PX4's name: AUTO.LOITER
    FlightMode.TAKEOFF: Code(4, 2, _AUTO),
    FlightMode.LAND: Code(4, 6, _AUTO),
    FlightMode.OFFBOARD: Code(6, 0, _EXTERNAL),
}
_BY_CODE = {(code.main, code.sub): mode for mode, code in PX4_CODES.items()}

# landed_state of EXTENDED_SYS_STATE in the air; on the ground the value is always ON_GROUND.
AIRBORNE_STATE: Mapping[FlightMode, int] = {
    FlightMode.HOLD: dialect.MAV_LANDED_STATE_IN_AIR,
    FlightMode.TAKEOFF: dialect.MAV_LANDED_STATE_TAKEOFF,
    FlightMode.LAND: dialect.MAV_LANDED_STATE_LANDING,
    FlightMode.OFFBOARD: dialect.MAV_LANDED_STATE_IN_AIR,
}


def mode_of(main: int, sub: int) -> FlightMode | None:
    """Return the mode with PX4's two numbers; None: this project's vehicles do not support it."""
    return _BY_CODE.get((main, 0 if main == PX4_CODES[FlightMode.OFFBOARD].main else sub))


CAPABILITIES = (
    _M.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | _M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | _M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | _M.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | _M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | _M.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
)
VERSION = 1 << 24 | 18 << 16 | 255  # AUTOPILOT_VERSION.flight_sw_version: 1.18.0, official
FORCE = 21196.0  # param2 of MAV_CMD_COMPONENT_ARM_DISARM that forces a disarm
# Messages of every tick, in this order: clients combine a position with the attitude received before it.
EVERY_TICK = (_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
# Indoors there is no GPS, but clients recognise a good position only by its bit (MAVSDK telemetry_impl.cpp).
POSITION_SOURCE = _M.MAV_SYS_STATUS_SENSOR_GPS | _M.MAV_SYS_STATUS_SENSOR_VISION_POSITION
