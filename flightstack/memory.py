"""What the controller remembers from tick to tick; everything else is computed anew."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import inf

from flightstack.types import ZERO, Phase, Vec3


class AbortWay(IntEnum):
    """How an abort ends the flight."""

    NONE = 0
    MOTORS_OFF = 1  # emergency stop
    HANDS_OFF = 2  # somebody else has the vehicle, or it never flew
    LAND_HERE = 3  # we don't know where we are or where the target is: the vehicle lands by itself
    FLY_CLEAR = 4  # climb, fly clear of the target, then land


@dataclass(slots=True)
class Memory:
    """Plain values only, so that it can be logged and compared."""

    phase: Phase = Phase.WAIT
    phase_since_s: float = 0.0
    started_s: float = inf  # when the landing began
    bad_since_s: float = inf  # start of the present input loss
    good_since_s: float = inf  # since when all inputs have been good
    contact_since_s: float = inf
    contact: bool = False  # stands on the pad
    was_armed: bool = False
    was_external: bool = False
    climbed: bool = False  # the take-off climb is over
    clear: bool = False  # flown clear after an abort
    retries: int = 0
    ground_z_m: float = inf  # height at which it stood
    yaw_rad: float | None = None  # heading held in the whole flight
    command: Vec3 = ZERO  # last command; base of the slew limit
    commanding: bool = False  # a command went out in the last tick
    target_position_enu_m: Vec3 | None = None  # last known
    abort_way: AbortWay = AbortWay.NONE
    reason: str = ""
