"""Requirements of each cell: how the flight may end, how soon it is aborted, how far h may fall.

A companion that has only its links must not let the vehicle fall, must not continue silently on data that it
can detect as stale or wrong, and must start to bring the vehicle to safety within 2 s unless it is on the
pad. Several ends are allowed only where chance decides between safe ones; the reason then has "chance".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from types import MappingProxyType

from flightstack.core.types import Phase


class Part(StrEnum):
    """What fails."""

    OWN_STATE = "vehicle state"
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


WITHIN_S = 2.0  # until it is given up, where it has to be
H_MIN_M = -0.005  # outside the pad while the companion flies: a violation below it


@dataclass(frozen=True)
class Need:
    ends: frozenset[End]  # how the flight may end
    why: str
    # longest time from the fault to the abort or to motors off, s; None: the flight may continue, because the
    # fault does no harm
    within_s: float | None = WITHIN_S
    h_min_m: float = H_MIN_M  # lowest h outside the pad while the companion flies
    undetectable: bool = False  # no process on board can detect it; the requirements bound the harm
    falls_short: str = ""  # known failure by chance and its reason; empty if there is none
    short_ends: frozenset[End] = frozenset()  # ends of that failure


def _need(*ends: End, why: str, **more: object) -> Need:
    return Need(frozenset(ends), why, **more)  # type: ignore[arg-type]


_CRASHED = frozenset({End.CRASHED})
LANDED, ABORTED, VEHICLE_LANDS = End.LANDED, End.ABORTED, End.VEHICLE_LANDS

_HARMLESS = _need(LANDED, why="still recent enough", within_s=None)
_ON_THE_PAD = _need(
    LANDED, why="centimetres above the pad: it descends with the last set-point", within_s=None
)
_NO_TARGET = _need(ABORTED, why="no valid target: hold, climb, wait, fly clear, land")
_PAUSES = _need(
    LANDED, ABORTED, why="holds at each pause, then continues; aborts after too many: chance", within_s=None
)
_NO_OWN = _need(
    ABORTED,
    VEHICLE_LANDS,
    why="no valid vehicle state: no set-points, and the autopilot lands where it is",
)
_NO_OWN_OVER = _need(
    ABORTED, VEHICLE_LANDS, LANDED, why="the same, with the robot below: chance",
    falls_short="lands where it is and hits the edge of a robot that drives off slowly: without a "
    "vehicle state no set-point is sent, not even one that leads away", short_ends=_CRASHED,
)  # fmt: skip
_NO_ESTIMATE = _need(
    VEHICLE_LANDS, ABORTED, why="the autopilot has no state either and lands by itself in 1 s"
)
_NO_ESTIMATE_OVER = _need(
    VEHICLE_LANDS, ABORTED, LANDED, why="the same, with the robot below: chance",
    falls_short="the autopilot lands where it is 1 s later: by chance on the edge of the robot, where it "
    "tips over", short_ends=_CRASHED,
)  # fmt: skip
_LATE_LOOP = _need(
    LANDED, ABORTED, why="0.2 s of dead time make the loop oscillate: it reaches the pad in time by chance",
    within_s=None, h_min_m=-0.05, undetectable=True,
    falls_short="a growing oscillation counts as not following its set-points; then the autopilot lands "
    "where it is: by chance on the robot", short_ends=_CRASHED,
)  # fmt: skip
_LATE_OVER = _need(LANDED, why="the same, but too short to oscillate", within_s=None, undetectable=True)
_NO_HEARTBEAT = _need(ABORTED, why="sent at 1 Hz and two may be lost: 3 s", within_s=3.5)
_HEARTBEAT_OR_DOWN = _need(
    LANDED, ABORTED, why="aborts after 3 s, or lands before that: chance", within_s=None
)
_STALE_MODE = _need(
    LANDED, why="contains nothing new before the motors stop, and they stop by command", within_s=None,
    undetectable=True,
)  # fmt: skip
_CONTRADICTS = _need(
    ABORTED,
    VEHICLE_LANDS,
    why="reports disarmed or another mode in the air: another sender flies, or it is wrong",
)
_CONTRADICTS_OVER = _need(
    LANDED, ABORTED, VEHICLE_LANDS, why="the same, with the robot below: chance",
    falls_short="lands at once where it is: by chance on the edge of a robot that drives off",
    short_ends=_CRASHED,
)  # fmt: skip
_STREAM_LOST = _need(VEHICLE_LANDS, why="the autopilot receives no set-points for 0.5 s and lands")
_STREAM_LOST_OVER = _need(
    LANDED, VEHICLE_LANDS, ABORTED, why="the same, with the robot below: chance", within_s=WITHIN_S
)
_NOT_FLOWN = _need(ABORTED, why="does not follow its set-points: the autopilot's own landing needs none")
_NOT_FLOWN_OVER = _need(
    ABORTED, LANDED, why="the same, or down before it is detected: chance; until then it flies elsewhere",
    h_min_m=-0.2, falls_short="by chance it strikes the robot before the fault is detected: from 0.2 m "
    "above that takes half a second", short_ends=_CRASHED,
)  # fmt: skip
_NOT_FLOWN_YET = _need(
    ABORTED,
    why="the rate of climb is not checked in the first 7 s of a take-off",
    within_s=8.0,
)
_STAMPS = _need(LANDED, why="ages count from arrival: stamps only give the order", within_s=None)

# in the order of Moment
_Row = tuple[Need, Need, Need, Need]
_ALWAYS_HARMLESS: _Row = (_HARMLESS, _HARMLESS, _HARMLESS, _HARMLESS)
_OWN: _Row = (_NO_OWN, _NO_OWN, _NO_OWN_OVER, _ON_THE_PAD)
_TARGET: _Row = (_NO_TARGET, _NO_TARGET, _NO_TARGET, _ON_THE_PAD)
_OFTEN: _Row = (_PAUSES, _PAUSES, _PAUSES, _ON_THE_PAD)
_LATE_OWN: _Row = (_LATE_LOOP, _LATE_LOOP, _LATE_LOOP, _LATE_OVER)
_LATE: _Row = (_LATE_LOOP, _LATE_LOOP, _LATE_OVER, _LATE_OVER)
_SILENT: _Row = (_NO_HEARTBEAT, _HEARTBEAT_OR_DOWN, _HEARTBEAT_OR_DOWN, _ON_THE_PAD)
_UNTRUE: _Row = (_CONTRADICTS, _CONTRADICTS, _CONTRADICTS_OVER, _ON_THE_PAD)
_ASTRAY: _Row = (_NOT_FLOWN_YET, _NOT_FLOWN, _NOT_FLOWN_OVER, _NOT_FLOWN_OVER)
_STAMPED: _Row = (_STAMPS, _STAMPS, _STAMPS, _STAMPS)


def _disk(what: str) -> _Row:
    need = _need(End.CONTINUES, why=what, within_s=None)
    return (need, need, need, need)


_ROWS: Mapping[Part, Mapping[Way, _Row]] = MappingProxyType(
    {
        Part.OWN_STATE: {
            Way.OFF: (_NO_ESTIMATE, _NO_ESTIMATE, _NO_ESTIMATE_OVER, _ON_THE_PAD),
            Way.STUCK: _OWN,
            Way.GARBAGE: _OWN,
            Way.WRONG: _OWN,
            Way.SLOW: _ALWAYS_HARMLESS,
            Way.DELAYED: _LATE_OWN,
            Way.INTERMITTENT: _OFTEN,
        },
        Part.TARGET_STATE: {
            Way.OFF: _TARGET,
            Way.STUCK: _TARGET,
            Way.GARBAGE: _TARGET,
            Way.WRONG: _TARGET,
            Way.SLOW: _ALWAYS_HARMLESS,
            Way.DELAYED: _ALWAYS_HARMLESS,
            Way.INTERMITTENT: _OFTEN,
        },
        Part.HEARTBEAT: {
            Way.OFF: _SILENT,
            Way.STUCK: (_STALE_MODE, _STALE_MODE, _STALE_MODE, _STALE_MODE),
            Way.GARBAGE: _UNTRUE,
            Way.WRONG: _UNTRUE,
            Way.SLOW: _SILENT,
            Way.DELAYED: (_STALE_MODE, _STALE_MODE, _STALE_MODE, _STALE_MODE),
            Way.INTERMITTENT: (_STALE_MODE, _STALE_MODE, _STALE_MODE, _STALE_MODE),
        },
        Part.SETPOINTS: {
            Way.OFF: (_STREAM_LOST, _STREAM_LOST, _STREAM_LOST_OVER, _STREAM_LOST_OVER),
            Way.STUCK: _ASTRAY,
            Way.GARBAGE: _ASTRAY,
            Way.WRONG: _ASTRAY,
            Way.SLOW: _ALWAYS_HARMLESS,
            Way.DELAYED: _LATE,
            Way.INTERMITTENT: _ALWAYS_HARMLESS,
        },
        Part.CLOCK: {
            Way.OFF: _OWN,
            Way.STUCK: _OWN,
            Way.GARBAGE: _OWN,
            Way.WRONG: _STAMPED,
            Way.SLOW: _STAMPED,
            Way.DELAYED: _STAMPED,
            Way.INTERMITTENT: _OFTEN,
        },
        Part.ZENOH: {
            Way.OFF: _TARGET,
            Way.STUCK: _TARGET,
            Way.GARBAGE: _OFTEN,
            Way.WRONG: _TARGET,
            Way.SLOW: _ALWAYS_HARMLESS,
            Way.DELAYED: _OFTEN,
            Way.INTERMITTENT: _OFTEN,
        },
        Part.DISK: {
            Way.OFF: _disk("full: the log ends there and reports it"),
            Way.STUCK: _disk("hangs: data that do not fit into memory are dropped and counted"),
            Way.GARBAGE: _disk("writes wrong bytes: checksums show it"),
            Way.WRONG: _disk("not writable: the log ends there and reports it"),
            Way.SLOW: _disk("nothing is lost"),
            Way.DELAYED: _disk("nothing is lost"),
            Way.INTERMITTENT: _disk("fails now and then: the log ends at the first failure and reports it"),
        },
    }
)

GRID: Mapping[tuple[Part, Way, Moment], Need] = MappingProxyType(
    {
        (part, way, moment): need
        for part, rows in _ROWS.items()
        for way, row in rows.items()
        for moment, need in zip(Moment, row, strict=True)
    }
)
