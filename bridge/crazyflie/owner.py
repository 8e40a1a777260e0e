"""Who may fly the Crazyflie: the sender of set-points, until it falls silent; landing is for everybody."""

from __future__ import annotations

import math
from enum import Enum

Sender = tuple[int, int]  # MAVLink system id, component id

SILENCE_S = 1.0  # s after which control is free; PX4's COM_OF_LOSS_T
GROUND_STATIONS = frozenset({255, 245})  # QGroundControl, MAVProxy and dronekit; MAVSDK


class Right(Enum):
    """Who may do something while somebody has control."""

    ANYBODY = "anybody"
    OWNER = "owner"
    OWNER_OR_GROUND = "owner or ground station"


class Owner:
    """One sender of set-points at a time."""

    def __init__(self) -> None:
        self._owner: Sender | None = None
        self._heard_s = -math.inf

    def admit(self, sender: Sender, now_s: float) -> str | None:
        """Take a set-point's sender; why not, when another has control."""
        reason = self.forbids(sender, Right.OWNER, now_s)
        if reason is None:
            self._owner, self._heard_s = sender, now_s
        return reason

    def forbids(self, sender: Sender, right: Right, now_s: float) -> str | None:
        """Why this sender may not, None if it may."""
        free = self._owner is None or now_s - self._heard_s > SILENCE_S
        if free or right is Right.ANYBODY or sender == self._owner or self._owner is None:
            return None
        if right is Right.OWNER_OR_GROUND and sender[0] in GROUND_STATIONS:
            return None
        return f"{self._owner[0]}/{self._owner[1]} has control"

    def release(self) -> None:
        """Free for anybody."""
        self._owner = None
