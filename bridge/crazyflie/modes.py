"""Flight modes of the bridge with PX4's codes (px4_custom_mode.h), as its clients know them."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect


class Code(NamedTuple):
    """A mode on the wire."""

    main: int
    sub: int
    base: int  # MAV_MODE_FLAG, disarmed (PX4 streams/HEARTBEAT.hpp)
    landed_state: int  # of EXTENDED_SYS_STATE in the air

    @property
    def custom_mode(self) -> int:
        """``custom_mode`` of HEARTBEAT and SET_MODE."""
        return self.main << 16 | self.sub << 24


class Mode(Enum):
    """What the bridge can do."""

    HOLD = "hold"
    TAKEOFF = "take-off"
    LAND = "land"
    OFFBOARD = "offboard"


_AUTO = 1 | 4 | 8 | 16  # custom, auto, guided, stabilised
CODES: dict[Mode, Code] = {
    Mode.HOLD: Code(4, 3, _AUTO, dialect.MAV_LANDED_STATE_IN_AIR),
    Mode.TAKEOFF: Code(4, 2, _AUTO, dialect.MAV_LANDED_STATE_TAKEOFF),
    Mode.LAND: Code(4, 6, _AUTO, dialect.MAV_LANDED_STATE_LANDING),
    Mode.OFFBOARD: Code(6, 0, 1 | 16, dialect.MAV_LANDED_STATE_IN_AIR),
}
_BY_CODE = {(code.main, code.sub): mode for mode, code in CODES.items()}


def mode_of(main: int, sub: int) -> Mode | None:
    """Mode of PX4's codes; None if the bridge has no such mode."""
    return _BY_CODE.get((main, 0 if main == CODES[Mode.OFFBOARD].main else sub))
