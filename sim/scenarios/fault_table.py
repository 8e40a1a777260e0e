"""What can fail, and how: one table of all faults with their values, units and ranges.

Who carries a fault out: ``sim.faults.drive`` (motors, battery), ``sim.faults.samples``
(motion capture, own state, target odometry), ``sim.faults.link`` (everything on the MAVLink wire),
``sim.robot.target_motion`` (the robot itself).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType


class What(Enum):
    """The part that fails."""

    MOTOR = "motor"
    BATTERY = "battery"
    MOCAP = "mocap"  # motion capture on its way into the on-board estimator
    OWN_STATE = "own_state"  # the estimate on its way from the firmware to its autopilot
    TARGET_ODOMETRY = "target_odometry"
    ROBOT = "robot"  # its drive
    LINK_OUT = "link_out"  # MAVLink, vehicle to companion
    LINK_IN = "link_in"  # MAVLink, companion to vehicle
    HEARTBEAT = "heartbeat"  # of the vehicle
    SETPOINTS = "setpoints"  # the companion's, on their way into the autopilot
    CLOCK = "clock"  # time stamps of the vehicle's telemetry


class Kind(Enum):
    """How it fails."""

    WEAK = "weak"
    DEAD = "dead"
    OFF = "off"
    STUCK = "stuck"
    WRONG = "wrong"
    SLOW = "slow"
    DELAYED = "delayed"
    INTERMITTENT = "intermittent"
    GARBAGE = "garbage"
    DRIFT = "drift"
    LOSS = "loss"
    BURST_LOSS = "burst_loss"
    REORDER = "reorder"
    DUPLICATE = "duplicate"
    DROP = "drop"


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a fault: what it means, its unit, its range, and what holds when it is not given."""

    meaning: str
    unit: str
    low: float
    high: float
    default: float


@dataclass(frozen=True, slots=True)
class Cell:
    """One possible fault."""

    effect: str
    value: Number | None = None
    period: Number | None = None  # of ``period_s``
    offset: bool = False  # takes ``offset_m`` and ``yaw_rad``
    healable: bool = True  # has an end


_REST = Number("time from the start of one pause to the next", "s", 0.02, 60.0, 1.0)
_PAUSE = Number("length of a pause", "s", 0.01, 30.0, 0.3)
_EACH_NTH = Number("n", "1", 2.0, 1000.0, 10.0)
_EXTRA = Number("extra delay", "s", 0.005, 5.0, 0.2)
_PROBABILITY = Number("probability", "1", 0.001, 1.0, 0.1)

_SAMPLES: Mapping[Kind, Cell] = {
    Kind.OFF: Cell("no samples"),
    Kind.STUCK: Cell("repeats the first sample, with new time stamps"),
    Kind.WRONG: Cell("position and heading are wrong by `offset_m`, `yaw_rad`", offset=True),
    Kind.SLOW: Cell("only every n-th sample", _EACH_NTH),
    Kind.DELAYED: Cell("samples arrive later, in order; at the end the delayed ones arrive at once", _EXTRA),
    Kind.INTERMITTENT: Cell("pauses without samples", _PAUSE, _REST),
    Kind.GARBAGE: Cell(
        "every sample jumps, uniformly, and has a random heading",
        Number("half-width on each axis", "m", 0.01, 100.0, 1.0),
    ),
    Kind.DRIFT: Cell(
        "position drifts in a random direction", Number("speed of the error", "m/s", 0.001, 2.0, 0.05)
    ),
}
_MESSAGES: Mapping[Kind, Cell] = {
    Kind.OFF: Cell("no messages"),
    Kind.SLOW: Cell("only every n-th message", _EACH_NTH),
    Kind.DELAYED: Cell("messages arrive later", _EXTRA),
    Kind.INTERMITTENT: Cell("pauses without messages", _PAUSE, _REST),
}
_RANDOM: Mapping[Kind, Cell] = {
    Kind.LOSS: Cell("messages are lost independently", _PROBABILITY),
    Kind.REORDER: Cell("messages are delayed by 30 ms, so that later ones overtake them", _PROBABILITY),
    Kind.DUPLICATE: Cell("messages arrive twice", _PROBABILITY),
}
_LINK: Mapping[Kind, Cell] = {
    **_MESSAGES,
    **_RANDOM,
    Kind.STUCK: Cell("the link stalls: messages wait, and arrive at once at the end"),
    Kind.BURST_LOSS: Cell(
        "everything is lost in bursts (two states, exponential times)",
        Number("mean length of a burst", "s", 0.005, 10.0, 0.1),
        Number("mean time between bursts", "s", 0.02, 60.0, 1.0),
    ),
    Kind.GARBAGE: Cell("a byte of a message is damaged, its checksum does not fit", _PROBABILITY),
}

TABLE: Mapping[What, Mapping[Kind, Cell]] = MappingProxyType(
    {
        What.MOTOR: {
            Kind.WEAK: Cell(
                "turns slower than commanded", Number("fraction of the hover thrust", "1", 0.0, 1.0, 0.6)
            ),
            Kind.DEAD: Cell("no drive; it slows down"),
            Kind.STUCK: Cell("keeps its present speed, whatever is commanded, also after disarming"),
        },
        What.BATTERY: {
            Kind.OFF: Cell("empty at once"),
            Kind.DROP: Cell("voltage is lower", Number("by", "V", 0.05, 2.5, 0.5)),
            Kind.LOSS: Cell(
                "charge is lost at once",
                Number("fraction of a full charge", "1", 0.01, 1.0, 0.5),
                healable=False,
            ),
        },
        What.MOCAP: _SAMPLES,
        What.OWN_STATE: _SAMPLES,
        What.TARGET_ODOMETRY: _SAMPLES,
        What.ROBOT: {Kind.STUCK: Cell("wheels lock: it stops at once, and drives again at the end")},
        What.LINK_OUT: _LINK,
        What.LINK_IN: _LINK,
        What.HEARTBEAT: {
            **_MESSAGES,
            Kind.STUCK: Cell("repeats the first heartbeat"),
            Kind.WRONG: Cell("reports armed when disarmed, disarmed when armed"),
            Kind.GARBAGE: Cell("mode and state are random numbers"),
        },
        What.SETPOINTS: {
            **_MESSAGES,
            **_RANDOM,
            Kind.STUCK: Cell("repeats the first velocity"),
            Kind.WRONG: Cell("the velocity is scaled", Number("factor", "1", -2.0, 5.0, -1.0)),
            Kind.GARBAGE: Cell(
                "the velocity is random", Number("half-width on each axis", "m/s", 0.01, 5.0, 0.5)
            ),
        },
        What.CLOCK: {
            Kind.OFF: Cell("time stamps are zero"),
            Kind.STUCK: Cell("the clock stands still"),
            Kind.WRONG: Cell("the clock jumps", Number("by", "s", -1000.0, 1000.0, 10.0)),
            Kind.SLOW: Cell("the clock runs slow", Number("speed", "1", 0.01, 0.999, 0.9)),
            Kind.DELAYED: Cell("time stamps are old", _EXTRA),
            Kind.INTERMITTENT: Cell("the clock stands still in pauses", _PAUSE, _REST),
            Kind.GARBAGE: Cell("time stamps are random"),
        },
    }
)
