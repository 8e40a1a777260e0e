"""The words of the grid: parts, ways to fail, moments, and how a flight can end."""

from __future__ import annotations

from enum import Enum, StrEnum

from flightstack.core.types import Phase


class Part(StrEnum):
    """What fails."""

    OWN_STATE = "own state"
    TARGET_STATE = "target state"
    HEARTBEAT = "heartbeat"
    SETPOINTS = "set-point path"
    CLOCK = "clock"
    ZENOH = "Zenoh link"
    DISK = "log disk"


class Way(StrEnum):
    """How it fails."""

    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"


class Moment(Enum):
    """When it fails, for good."""

    TAKEOFF = Phase.TAKEOFF  # in the climb, 0.2 m above the ground: standing there nothing could fall
    APPROACH = Phase.APPROACH
    LAND = Phase.LAND
    TOUCHDOWN = Phase.TOUCHDOWN


class End(StrEnum):
    """How a flight ended."""

    LANDED = "LANDED"  # rests upright on the pad, motors off
    ABORTED = "ABORTED"  # given up and declared, stands upright on the floor, motors off
    VEHICLE_LANDS = "VEHICLE_LANDS"  # the same, brought down by the autopilot's own fail-safe
    CONTINUES = "CONTINUES"  # flown to the last bit as without the fault
    CRASHED = "CRASHED"  # fell, tumbled, or struck robot or pad's edge
    MISSED = "MISSED"  # on the floor, and nobody had given up
    FLYING = "FLYING"  # motors not off in the end
