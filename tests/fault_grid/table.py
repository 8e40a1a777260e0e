"""What is demanded of each cell: how the flight may end, how soon it is given up, how far h may fall.

Demanded is what a safety engineer would want of a companion that knows nothing but its links: nothing falls,
nothing goes on silently on data that can be known to be stale or wrong, and within 2 s the vehicle is being
brought to safety or is on the pad already. Several ends are allowed only where chance decides between safe
ones; then the reason says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from types import MappingProxyType

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


WITHIN_S = 2.0  # until it is given up, where it has to be
H_MIN_M = -0.005  # outside the pad while the companion flies: a violation below it


@dataclass(frozen=True)
class Need:
    """Demands on one cell.

    Attributes:
        ends: how the flight may end.
        why: the reason.
        within_s: s from the fault until it is given up or the motors are off; None: it may go on, for it can
            do no harm.
        h_min_m: lowest h outside the pad while the companion flies.
        undetectable: nobody on board can know of it; the demands are a bound of the harm.
        falls_short: what is known to go wrong by chance and why; empty where nothing is.
        short_ends: the ends that are meant by that.
    """

    ends: frozenset[End]
    why: str
    within_s: float | None = WITHIN_S
    h_min_m: float = H_MIN_M
    undetectable: bool = False
    falls_short: str = ""
    short_ends: frozenset[End] = frozenset()


def _need(*ends: End, why: str, **more: object) -> Need:
    return Need(frozenset(ends), why, **more)  # type: ignore[arg-type]


_CRASHED = frozenset({End.CRASHED})
LANDED, ABORTED, VEHICLE_LANDS = End.LANDED, End.ABORTED, End.VEHICLE_LANDS

_HARMLESS = _need(LANDED, why="fresh enough to fly by", within_s=None)
_ON_THE_PAD = _need(
    LANDED, why="centimetres above the pad: it sinks on with what was sent last", within_s=None
)
_NO_TARGET = _need(ABORTED, why="no target to be believed: hold, climb, wait, fly clear, land")
_PAUSES = _need(
    LANDED, ABORTED, why="hold at each pause and go on; after too many it gives up: chance", within_s=None
)
_NO_OWN = _need(
    ABORTED,
    VEHICLE_LANDS,
    why="no own state to be believed: no set-points, and the autopilot lands where it is",
)
_NO_OWN_OVER = _need(
    ABORTED, VEHICLE_LANDS, LANDED, why="the same, with the robot below: chance",
    falls_short="lands where it is, and a robot that drives off slowly is hit at its edge: no set-point is "
    "sent without an own state, not even one that leads away", short_ends=_CRASHED,
)  # fmt: skip
_NO_ESTIMATE = _need(VEHICLE_LANDS, ABORTED, why="the autopilot misses it, too, and lands by itself in 1 s")
_NO_ESTIMATE_OVER = _need(
    VEHICLE_LANDS, ABORTED, LANDED, why="the same, with the robot below: chance",
    falls_short="the autopilot lands where it is 1 s later, whatever is there: by chance on the edge of the "
    "robot, from where it tips over", short_ends=_CRASHED,
)  # fmt: skip
_LATE_LOOP = _need(
    LANDED, ABORTED, why="0.2 s of dead time make the loop swing: chance whether it gets to the pad in time",
    within_s=None, h_min_m=-0.05, undetectable=True,
    falls_short="a swing that grows is not following, and then the autopilot lands where it is: by chance on "
    "the robot", short_ends=_CRASHED,
)  # fmt: skip
_LATE_OVER = _need(LANDED, why="the same, too short to swing up", within_s=None, undetectable=True)
_NO_HEARTBEAT = _need(ABORTED, why="comes at 1 Hz and two may be lost: 3 s", within_s=3.5)
_HEARTBEAT_OR_DOWN = _need(
    LANDED, ABORTED, why="given up after 3 s, or landed before that: chance", within_s=None
)
_STALE_MODE = _need(
    LANDED, why="tells nothing new before the motors stop, and they stop by command", within_s=None,
    undetectable=True,
)  # fmt: skip
_CONTRADICTS = _need(
    ABORTED, VEHICLE_LANDS, why="says disarmed or another mode in the air: not ours to fly, or not true"
)
_CONTRADICTS_OVER = _need(
    LANDED, ABORTED, VEHICLE_LANDS, why="the same, with the robot below: chance",
    falls_short="lands at once, whatever is below: by chance on the edge of a robot that drives off",
    short_ends=_CRASHED,
)  # fmt: skip
_STREAM_LOST = _need(VEHICLE_LANDS, why="the autopilot misses set-points for 0.5 s and lands")
_STREAM_LOST_OVER = _need(
    LANDED, VEHICLE_LANDS, ABORTED, why="the same, with the robot below: chance", within_s=WITHIN_S
)
_NOT_FLOWN = _need(
    ABORTED, why="does not fly what it is told: the autopilot's own landing needs no set-points"
)
_NOT_FLOWN_OVER = _need(
    ABORTED, LANDED, why="the same, or down before it shows: chance; until then it flies elsewhere",
    h_min_m=-0.2, falls_short="by chance it strikes the robot before anything shows: from 0.2 m above that "
    "takes half a second", short_ends=_CRASHED,
)  # fmt: skip
_NOT_FLOWN_YET = _need(
    ABORTED,
    why="how fast it rises is the autopilot's in the first 7 s of a take-off, then it shows",
    within_s=8.0,
)
_STAMPS = _need(LANDED, why="ages count from arrival: stamps only order", within_s=None)

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
            Way.OFF: _disk("full: the log ends there and says so"),
            Way.STUCK: _disk("hangs: what does not fit into memory is dropped and counted"),
            Way.GARBAGE: _disk("writes other bytes: checksums tell"),
            Way.WRONG: _disk("not writable: the log ends there and says so"),
            Way.SLOW: _disk("nothing is lost"),
            Way.DELAYED: _disk("nothing is lost"),
            Way.INTERMITTENT: _disk("fails now and then: the log ends at the first time and says so"),
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
