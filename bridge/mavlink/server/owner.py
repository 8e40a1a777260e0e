"""Control of the vehicle: one sender of set-points has it, and few commands of other senders are obeyed.

PX4 obeys the newest message. Here the sender of a stream of set-points controls the vehicle: a second
companion, a forgotten script or a stranger cannot take it over in flight.
"""

from __future__ import annotations

import math
from enum import Enum

from bridge.mavlink.transport.address import Peer

# system id, component id, and the address where there is one: ids alone are not unique
Sender = tuple[int, int] | tuple[int, int, Peer]

# System ids of ground stations: QGroundControl, MAVProxy and dronekit use 255, MAVSDK uses 245.
GROUND_STATIONS = frozenset({255, 245})


class Right(Enum):
    """Which senders may do something while one of them has control."""

    ANYBODY = "anybody"  # changes nothing, or makes the vehicle safer: questions, telemetry, landing
    OWNER = "owner"  # changes what the vehicle does
    OWNER_OR_GROUND = "owner or ground station"  # motors off in an emergency


class ControlOwner:
    """The sender that has control; it loses control when its set-points stop."""

    def __init__(self) -> None:
        self._owner: Sender | None = None
        self._heard_s = -math.inf

    def admit(self, sender: Sender, now_s: float, silence_s: float) -> str | None:
        """Give control to the sender of a valid set-point, if no other sender has it.

        Without set-points for ``silence_s`` control is free. The reason when another
        sender has control, else None.
        """
        if sender != self._owner and self._owner is not None and now_s - self._heard_s <= silence_s:
            return f"Set-point dropped: {_name(self._owner, sender)} has control"
        self._owner, self._heard_s = sender, now_s
        return None

    def forbids(self, sender: Sender, right: Right, now_s: float, silence_s: float) -> str | None:
        """Why this sender may not do something now, None if it may."""
        if right is Right.ANYBODY or self._owner is None or sender == self._owner:
            return None
        if now_s - self._heard_s > silence_s:
            return None
        if right is Right.OWNER_OR_GROUND and sender[0] in GROUND_STATIONS:
            return None
        return f"{_name(self._owner, sender)} has control"

    def release(self) -> None:
        """Make control free, for example after disarming."""
        self._owner = None


def _name(owner: Sender, other: Sender) -> str:
    """Ids of the one that has control; with its address if the other has the same ids."""
    at = f" at {owner[2][0]}:{owner[2][1]}" if len(owner) == 3 and owner[:2] == other[:2] else ""
    return f"{owner[0]}/{owner[1]}{at}"
