"""Requirements of each cell of the grid: allowed ends of the flight, latest abort, and lowest h.

A companion that has only its links must not let the vehicle fall, and must not continue silently on data that
it can detect as stale or wrong. Unless the vehicle is on the pad, the companion must start to bring it to
safety within 2 s. Several ends are allowed only where chance decides between safe ends; the reason then has
"chance".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum
from types import MappingProxyType

from flightstack.core.types import Phase


class Part(StrEnum):
    OWN_STATE = "vehicle state"
    TARGET_STATE = "target state"
    HEARTBEAT = "heartbeat"
    SETPOINTS = "set-point path"
    CLOCK = "clock"
    ZENOH = "Zenoh link"


class Way(StrEnum):
    OFF = "off"
    STUCK = "stuck"
    GARBAGE = "garbage"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"


class Moment(Enum):
    TAKEOFF = Phase.TAKEOFF  # 0.2 m above the ground, because a vehicle on the ground cannot fall
    APPROACH = Phase.APPROACH
    LAND = Phase.LAND
    TOUCHDOWN = Phase.TOUCHDOWN


class End(StrEnum):
    LANDED = "LANDED"  # the vehicle rests upright on the pad, motors off
    ABORTED = "ABORTED"  # the abort is declared; the vehicle rests upright on the floor, motors off
    VEHICLE_LANDS = "VEHICLE_LANDS"  # the vehicle rests upright on the floor after the autopilot's fail-safe
    CRASHED = "CRASHED"  # the vehicle fell, tumbled, or hit the robot or the pad's edge
    MISSED = "MISSED"  # the vehicle rests on the floor without a declared abort
    FLYING = "FLYING"  # the motors still run at the end


WITHIN_S = 2.0  # default of ``Need.within_s``, s
H_MIN_M = -0.005  # lowest allowed value of the barrier h outside the pad while the companion flies


@dataclass(frozen=True)
class Need:
    ends: frozenset[End]  # allowed ends of the flight
    why: str
    # maximum time from the fault to the abort or to motors off, s; None: the flight may continue, because the
    # fault does no harm
    within_s: float | None = WITHIN_S
    h_min_m: float = H_MIN_M  # lowest allowed h outside the pad while the companion flies
    undetectable: bool = False  # no process on board can detect the fault; only the harm is limited
    falls_short: str = ""  # reason of a failure that is known to occur by chance; empty: no such failure
    short_ends: frozenset[End] = frozenset()  # ends of the flight in this known failure


def _need(*ends: End, why: str, **more: object) -> Need:
    return Need(frozenset(ends), why, **more)  # type: ignore[arg-type]


_CRASHED = frozenset({End.CRASHED})
LANDED, ABORTED, VEHICLE_LANDS = End.LANDED, End.ABORTED, End.VEHICLE_LANDS

_HARMLESS = _need(LANDED, why="the data stay below their age limit", within_s=None)
_ON_THE_PAD = _need(
    LANDED, why="centimetres above the pad, the vehicle descends with the last set-point", within_s=None
)
_NO_TARGET = _need(ABORTED, why="no valid target: the vehicle holds, climbs, waits, flies clear and lands")
_PAUSES = _need(
    LANDED,
    ABORTED,
    why="the vehicle holds in each pause, then continues; after too many pauses it aborts (chance)",
    within_s=None,
)
_NO_OWN = _need(
    ABORTED,
    VEHICLE_LANDS,
    why="without a valid vehicle state no set-point is sent, and the autopilot lands immediately",
)
_NO_OWN_OVER = _need(
    ABORTED, VEHICLE_LANDS, LANDED,
    why="without a valid vehicle state the autopilot lands immediately; whether on the pad is chance",
    falls_short="the vehicle may hit the edge of a robot that drives off slowly, because without a vehicle "
    "state no set-point can lead it away", short_ends=_CRASHED,
)  # fmt: skip
_NO_ESTIMATE = _need(
    VEHICLE_LANDS,
    ABORTED,
    why="the autopilot has no vehicle state either, and its fail-safe lands within 1 s",
)
_NO_ESTIMATE_OVER = _need(
    VEHICLE_LANDS, ABORTED, LANDED,
    why="the fail-safe of the autopilot lands within 1 s; whether on the pad is chance",
    falls_short="the vehicle may land on the edge of the robot and tip over", short_ends=_CRASHED,
)  # fmt: skip
_LATE_LOOP = _need(
    LANDED, ABORTED,
    why="a dead time of 0.2 s makes the loop oscillate; whether it reaches the pad in time is chance",
    within_s=None, h_min_m=-0.05, undetectable=True,
    falls_short="with a growing oscillation the vehicle counts as not following its set-points; the "
    "autopilot then lands immediately, by chance on the robot", short_ends=_CRASHED,
)  # fmt: skip
_LATE_OVER = _need(
    LANDED, why="the time to contact is too short for an oscillation", within_s=None, undetectable=True
)
_NO_HEARTBEAT = _need(
    ABORTED, why="heartbeats are sent at 1 Hz, and two may be lost: abort after 3 s", within_s=3.5
)
_HEARTBEAT_OR_DOWN = _need(
    LANDED, ABORTED, why="the vehicle aborts after 3 s, or has landed before (chance)", within_s=None
)
_STALE_MODE = _need(
    LANDED, why="no heartbeat changes before the motors stop, and they stop by command", within_s=None,
    undetectable=True,
)  # fmt: skip
_CONTRADICTS = _need(
    ABORTED,
    VEHICLE_LANDS,
    why="the heartbeat reports disarmed or another mode in the air: another sender flies, or it is wrong",
)
_CONTRADICTS_OVER = _need(
    LANDED, ABORTED, VEHICLE_LANDS,
    why="the heartbeat reports disarmed or another mode in the air; whether the vehicle lands on the pad is "
    "chance", falls_short="the vehicle lands immediately, by chance on the edge of a robot that drives off",
    short_ends=_CRASHED,
)  # fmt: skip
_STREAM_LOST = _need(VEHICLE_LANDS, why="the autopilot lands after 0.5 s without set-points")
_STREAM_LOST_OVER = _need(
    LANDED, VEHICLE_LANDS, ABORTED, within_s=WITHIN_S,
    why="the autopilot lands after 0.5 s without set-points; whether on the pad is chance",
)  # fmt: skip
_NOT_FLOWN = _need(
    ABORTED, why="the vehicle does not follow its set-points, so the autopilot lands without them"
)
_NOT_FLOWN_OVER = _need(
    ABORTED, LANDED, h_min_m=-0.2,
    why="the vehicle does not follow its set-points; whether it is down before this is detected is chance",
    falls_short="the vehicle may strike the robot before the fault is detected: from a height of 0.2 m this "
    "takes half a second", short_ends=_CRASHED,
)  # fmt: skip
_NOT_FLOWN_YET = _need(
    ABORTED, why="the rate of climb is not checked in the first 7 s of a take-off", within_s=8.0
)
_STAMPS = _need(LANDED, why="ages count from the arrival; stamps only give the order", within_s=None)

# one need for each Moment, in order
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
