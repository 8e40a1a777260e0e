"""Server profile: what a vehicle of this project shows and accepts when it plays some autopilot.

The other side, how the flight stack talks to an autopilot, is ``bridge.mavlink.profiles``. All defaults are
those of PX4 1.18 (``px4_custom_mode.h``, ``Commander.cpp``, ``mavlink_receiver.cpp``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

_M = dialect


class FlightMode(Enum):
    """Flight modes of the vehicles."""

    HOLD = "hold"
    TAKEOFF = "take-off"
    LAND = "land"
    RETURN = "return"
    OFFBOARD = "offboard"


class Code(NamedTuple):
    """A mode on the wire."""

    main: int  # PX4_CUSTOM_MAIN_MODE (px4_custom_mode.h)
    sub: int  # PX4_CUSTOM_SUB_MODE_AUTO
    base: int  # MAV_MODE_FLAG of a disarmed vehicle

    @property
    def custom_mode(self) -> int:
        """PX4's ``custom_mode`` of HEARTBEAT and SET_MODE."""
        return self.main << 16 | self.sub << 24


_AUTO = 1 | 4 | 8 | 16  # custom, auto, guided, stabilised (PX4 streams/HEARTBEAT.hpp)
_EXTERNAL = 1 | 16  # custom, stabilised: PX4's offboard is not an auto mode

PX4_CODES: Mapping[FlightMode, Code] = {
    FlightMode.HOLD: Code(4, 3, _AUTO),  # AUTO.LOITER
    FlightMode.TAKEOFF: Code(4, 2, _AUTO),
    FlightMode.LAND: Code(4, 6, _AUTO),
    FlightMode.RETURN: Code(4, 5, _AUTO),  # AUTO.RTL
    FlightMode.OFFBOARD: Code(6, 0, _EXTERNAL),
}
_BY_CODE = {(code.main, code.sub): mode for mode, code in PX4_CODES.items()}

# PX4's other modes, and why no vehicle here has them.
_STICKS = "no stick input"
_NOT_HERE: Mapping[tuple[int, int], str] = {
    (1, 0): f"manual: {_STICKS}",
    (2, 0): f"altitude: {_STICKS}",
    (3, 0): f"position: {_STICKS}",
    (5, 0): f"acro: {_STICKS}",
    (7, 0): f"stabilized: {_STICKS}",
    (8, 0): f"rattitude: {_STICKS}",
    (10, 0): "termination: use command 185",
    (4, 1): "ready: use hold",
    (4, 4): "mission: no missions",
    (4, 8): "follow: not supported",
    (4, 9): "precision land: not supported",
}

# What EXTENDED_SYS_STATE says in the air; on the ground it is always ON_GROUND.
AIRBORNE_STATE: Mapping[FlightMode, int] = {
    FlightMode.HOLD: dialect.MAV_LANDED_STATE_IN_AIR,
    FlightMode.TAKEOFF: dialect.MAV_LANDED_STATE_TAKEOFF,
    FlightMode.LAND: dialect.MAV_LANDED_STATE_LANDING,
    FlightMode.RETURN: dialect.MAV_LANDED_STATE_IN_AIR,
    FlightMode.OFFBOARD: dialect.MAV_LANDED_STATE_IN_AIR,
}


def _px4_mode(main: int, sub: int) -> FlightMode | None:
    return _BY_CODE.get((main, 0 if main == PX4_CODES[FlightMode.OFFBOARD].main else sub))


def _px4_why_no_mode(main: int, sub: int) -> str:
    reason = _NOT_HERE.get((main, sub if main == PX4_CODES[FlightMode.HOLD].main else 0))
    return f"Mode refused: {reason}" if reason else f"Mode {main}/{sub} refused: there is none"


def _px4_pair(custom_mode: int) -> tuple[int, int]:
    return custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF


CAPABILITIES = (
    _M.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | _M.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | _M.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | _M.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | _M.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
RELEASE = 255  # FIRMWARE_VERSION_TYPE_OFFICIAL
# The order is that of a datagram: a position counts with the attitude that came before it.
EVERY_TICK = (_M.MAVLINK_MSG_ID_ATTITUDE, _M.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
# Indoors there is no GPS; but clients know a good position only by this bit (MAVSDK telemetry_impl.cpp).
POSITION_SOURCE = _M.MAV_SYS_STATUS_SENSOR_GPS | _M.MAV_SYS_STATUS_SENSOR_VISION_POSITION


@dataclass(frozen=True, slots=True, kw_only=True)
class ServerProfile:
    """One autopilot as a vehicle of this project plays it."""

    name: str
    mark: bytes  # 8 bytes, AUTOPILOT_VERSION.flight_custom_version: which of this project's vehicles it is
    sensors: int  # MAV_SYS_STATUS_SENSOR bits that are always in good order
    rates_hz: Mapping[int, float]  # default rates by message id; a message that is missing is sent on request
    autopilot: int = _M.MAV_AUTOPILOT_PX4
    version: int = 1 << 24 | 18 << 16 | RELEASE  # AUTOPILOT_VERSION.flight_sw_version
    capabilities: int = CAPABILITIES | _M.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    codes: Mapping[FlightMode, Code] = field(default_factory=lambda: PX4_CODES)  # the modes that it has
    custom_mode: Callable[[Code], int] = lambda code: code.custom_mode  # of HEARTBEAT
    # custom_mode to the pair of numbers that DO_SET_MODE has in param2 and param3; such a pair to the mode
    pair_of: Callable[[int], tuple[int, int]] = _px4_pair
    mode_of_pair: Callable[[int, int], FlightMode | None] = _px4_mode
    why_no_mode: Callable[[int, int], str] = _px4_why_no_mode
    refused: int = _M.MAV_RESULT_TEMPORARILY_REJECTED  # MAV_RESULT of what cannot be done now
    bytewise: bool = True  # an integer parameter travels as its bits
    long_frame: int = _M.MAV_FRAME_GLOBAL  # MAV_FRAME of a place in COMMAND_LONG
    frames: Mapping[int, bool] = field(  # of set-points; True: turned by the heading
        default_factory=lambda: {_M.MAV_FRAME_LOCAL_NED: False, _M.MAV_FRAME_BODY_NED: True}
    )
    # One mode takes off, follows set-points and stands still without them: its take-off needs that mode and
    # an armed vehicle, a set-point ends it, and a wrong set-point or silence means "stop", not a fail-safe.
    guided: bool = False
    every_tick: tuple[int, ...] = EVERY_TICK
    # message ids by MAV_DATA_STREAM of REQUEST_DATA_STREAM. PX4 ignores that message, since what MAVProxy and
    # dronekit ask for at their start (4 Hz of everything) would starve the companion of its position. Where
    # there are some, a request raises a rate or starts a stream, and never lowers a rate.
    data_streams: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    labels: Mapping[FlightMode, str] = field(default_factory=dict)  # names of modes, where they differ

    def mode_of(self, main: int, sub: int) -> FlightMode | None:
        """Mode of the numbers of DO_SET_MODE, None if the vehicle has no such mode."""
        mode = self.mode_of_pair(main, sub)
        return mode if mode in self.codes else None

    def label(self, mode: FlightMode) -> str:
        """Name of a mode for people."""
        return self.labels.get(mode, mode.value)

    def __deepcopy__(self, memo: dict[int, Any]) -> ServerProfile:
        """Itself: nothing of it ever changes."""
        return self
