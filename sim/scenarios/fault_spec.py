"""The faults of a scenario, ``[[fault]]``: what fails, how, and when.

One table has all faults with values, units and ranges. These modules implement the faults:
``sim.faults.vehicle_faults`` (motors, battery), ``sim.faults.samples`` (motion capture, vehicle state, target
odometry), ``sim.faults.link`` (all MAVLink messages) and ``sim.runners.robot`` (the robot).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, Each, span
from flightstack.core.types import ZERO, Vec3


class What(Enum):
    """The component that fails."""

    MOTOR = "motor"
    BATTERY = "battery"
    MOCAP = "mocap"  # samples of motion capture, before the on-board estimator
    OWN_STATE = "own_state"  # state estimate, between firmware and autopilot
    TARGET_ODOMETRY = "target_odometry"
    ROBOT = "robot"  # drive of the robot
    LINK_OUT = "link_out"  # all MAVLink messages from vehicle to companion
    LINK_IN = "link_in"  # all MAVLink messages from companion to vehicle
    HEARTBEAT = "heartbeat"  # heartbeat of the vehicle
    SETPOINTS = "setpoints"  # set-points of the companion, before the autopilot
    CLOCK = "clock"  # time stamps of the vehicle's telemetry


class Kind(Enum):
    """The way in which a component fails."""

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
    """A number of a fault: meaning, unit, range and default."""

    meaning: str
    unit: str
    low: float
    high: float
    default: float

    @property
    def range(self) -> str:
        """Return the allowed range and the meaning as text."""
        return f"{self.low:g} to {self.high:g} {self.unit}".removesuffix(" 1") + f" ({self.meaning})"


@dataclass(frozen=True, slots=True)
class Cell:
    """One possible combination of component and kind."""

    effect: str
    value: Number | None = None
    period: Number | None = None  # meaning and range of ``period_s``
    offset: bool = False  # whether the fault has ``offset_m`` and ``yaw_rad``
    healable: bool = True  # whether the fault can end


_REST = Number("time from the start of one pause to the next", "s", 0.02, 60.0, 1.0)
_PAUSE = Number("length of a pause", "s", 0.01, 30.0, 0.3)
_EACH_NTH = Number("n", "1", 2.0, 1000.0, 10.0)
_EXTRA = Number("extra delay", "s", 0.005, 5.0, 0.2)
_PROBABILITY = Number("probability", "1", 0.001, 1.0, 0.1)

_SAMPLES: Mapping[Kind, Cell] = {
    Kind.OFF: Cell("no sample arrives"),
    Kind.STUCK: Cell("the first sample is repeated with new time stamps"),
    Kind.WRONG: Cell("position and heading are wrong by `offset_m`, `yaw_rad`", offset=True),
    Kind.SLOW: Cell("only every n-th sample arrives", _EACH_NTH),
    Kind.DELAYED: Cell(
        "samples arrive late, in order; at the end all delayed samples arrive together", _EXTRA
    ),
    Kind.INTERMITTENT: Cell("pauses without samples", _PAUSE, _REST),
    Kind.GARBAGE: Cell(
        "every sample has a uniform position error and a random heading",
        Number("half-width on each axis", "m", 0.01, 100.0, 1.0),
    ),
    Kind.DRIFT: Cell(
        "position drifts in a random direction", Number("speed of the error", "m/s", 0.001, 2.0, 0.05)
    ),
}
_MESSAGES: Mapping[Kind, Cell] = {
    Kind.OFF: Cell("no message arrives"),
    Kind.SLOW: Cell("only every n-th message arrives", _EACH_NTH),
    Kind.DELAYED: Cell("messages arrive late", _EXTRA),
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
    Kind.STUCK: Cell("no message arrives; at the end all messages arrive together"),
    Kind.BURST_LOSS: Cell(
        "all messages are lost in bursts (two-state model, exponential times)",
        Number("mean length of a burst", "s", 0.005, 10.0, 0.1),
        Number("mean time between bursts", "s", 0.02, 60.0, 1.0),
    ),
    Kind.GARBAGE: Cell("a byte of a message is changed, so its checksum is wrong", _PROBABILITY),
}

TABLE: Mapping[What, Mapping[Kind, Cell]] = MappingProxyType(
    {
        What.MOTOR: {
            Kind.WEAK: Cell(
                "the motor turns slower than commanded",
                Number("fraction of the hover thrust", "1", 0.0, 1.0, 0.6),
            ),
            Kind.DEAD: Cell("the motor has no torque and slows down"),
            Kind.STUCK: Cell("the motor keeps its present speed for any command, also after disarming"),
        },
        What.BATTERY: {
            Kind.OFF: Cell("the battery is suddenly empty"),
            Kind.DROP: Cell("the voltage is lower", Number("difference", "V", 0.05, 2.5, 0.5)),
            Kind.LOSS: Cell(
                "a part of the charge is suddenly lost",
                Number("fraction of a full charge", "1", 0.01, 1.0, 0.5),
                healable=False,
            ),
        },
        What.MOCAP: _SAMPLES,
        What.OWN_STATE: _SAMPLES,
        What.TARGET_ODOMETRY: _SAMPLES,
        What.ROBOT: {
            Kind.STUCK: Cell("the wheels lock: the robot stops suddenly, and drives again at the end")
        },
        What.LINK_OUT: _LINK,
        What.LINK_IN: _LINK,
        What.HEARTBEAT: {
            **_MESSAGES,
            Kind.STUCK: Cell("the first heartbeat is repeated"),
            Kind.WRONG: Cell("the heartbeat reports armed when disarmed, and disarmed when armed"),
            Kind.GARBAGE: Cell("mode and state are random numbers"),
        },
        What.SETPOINTS: {
            **_MESSAGES,
            **_RANDOM,
            Kind.STUCK: Cell("the first velocity is repeated"),
            Kind.WRONG: Cell(
                "the velocity is multiplied by a factor", Number("factor", "1", -2.0, 5.0, -1.0)
            ),
            Kind.GARBAGE: Cell(
                "the velocity is random", Number("half-width on each axis", "m/s", 0.01, 5.0, 0.5)
            ),
        },
        What.CLOCK: {
            Kind.OFF: Cell("time stamps are zero"),
            Kind.STUCK: Cell("the clock stands still"),
            Kind.WRONG: Cell("the clock jumps", Number("jump", "s", -1000.0, 1000.0, 10.0)),
            Kind.SLOW: Cell("the clock runs slowly", Number("rate", "1", 0.01, 0.999, 0.9)),
            Kind.DELAYED: Cell("time stamps are too old", _EXTRA),
            Kind.INTERMITTENT: Cell("the clock stands still during pauses", _PAUSE, _REST),
            Kind.GARBAGE: Cell("time stamps are random"),
        },
    }
)


class After(Enum):
    """The event to which ``start_s`` is relative."""

    TIME = "time"  # the start of the run
    TAKEOFF = "takeoff"  # the first take-off; time zero for a start in hover
    LANDING = "landing"  # the start of the landing in the onboard process


# The vehicle does not know the phases of the onboard process, and the robot does not know the take-off.
ALLOWED_AFTER: dict[bool, tuple[After, ...]] = {
    True: (After.TIME, After.LANDING),  # faults of the robot
    False: (After.TIME, After.TAKEOFF),  # faults of the vehicle
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a scenario; its component and kind determine which values it can have.

    Raises ConfigError: the combination does not exist, or a value is missing, not allowed or out of range.
    """

    what: What
    kind: Kind
    start_s: Annotated[float, span(0.0, 3600.0)] = 0.0
    after: After = After.TIME
    duration_s: Annotated[float, span(0.001, 3600.0)] | None = None  # duration; None: end of the run
    motor: Annotated[int, span(1, 4)] | None = None  # number of the motor, as in the firmware
    value: float | None = None  # number of the fault; unit and range depend on component and kind
    period_s: float | None = None
    offset_m: Each[Annotated[float, span(-100.0, 100.0)]] | None = None  # offset of a wrong position, ENU
    yaw_rad: Annotated[float, span(-3.15, 3.15)] | None = None

    def __post_init__(self) -> None:
        kinds = TABLE[self.what]
        if self.kind not in kinds:
            names = ", ".join(sorted(k.value for k in kinds))
            raise ConfigError(f"kind: found '{self.kind.value}', {self.what.value} allows: {names}")
        cell = self.cell
        for key, found, number in (
            ("value", self.value, cell.value),
            ("period_s", self.period_s, cell.period),
        ):
            if found is None:
                continue
            if number is None:
                raise ConfigError(f"{key}: {self.name} takes none")
            if not number.low <= found <= number.high:
                raise ConfigError(f"{key}: found {found:g}, {self.name} allows {number.range}")
        if self.kind is Kind.INTERMITTENT and self.amount >= self.period:
            raise ConfigError(
                f"period_s: found {self.period:g}, it must exceed the pause's length, value = {self.amount:g}"
            )
        given = self.offset_m is not None or self.yaw_rad is not None
        if given and not cell.offset:
            raise ConfigError(f"offset_m, yaw_rad: {self.name} takes neither; kind 'wrong' of a state does")
        if cell.offset and not given:
            raise ConfigError(f"{self.name}: offset_m, yaw_rad or both are needed")
        if (self.what is What.MOTOR) is (self.motor is None):
            what = "missing; which one, 1 to 4?" if self.motor is None else f"{self.name} takes none"
            raise ConfigError(f"motor: {what}")
        allowed = ALLOWED_AFTER[self.of_the_robot]
        if self.after not in allowed:
            names = ", ".join(a.value for a in allowed)
            raise ConfigError(f"after: found '{self.after.value}', {self.what.value} allows: {names}")
        if self.duration_s is not None and not cell.healable:
            raise ConfigError(f"duration_s: {self.name} cannot end; leave it out")

    @property
    def of_the_robot(self) -> bool:
        """Whether the process of the ground robot, not of the vehicle, simulates this fault."""
        return self.what in (What.TARGET_ODOMETRY, What.ROBOT)

    @property
    def cell(self) -> Cell:
        """The table entry of this component and kind."""
        return TABLE[self.what][self.kind]

    @property
    def amount(self) -> float:
        """``value``, or its default; 0 without a default."""
        number = self.cell.value
        return self.value if self.value is not None else number.default if number is not None else 0.0

    @property
    def period(self) -> float:
        """``period_s``, or its default, s."""
        number = self.cell.period
        return self.period_s if self.period_s is not None else number.default if number is not None else 0.0

    @property
    def offset(self) -> Vec3:
        """``offset_m``, ENU, m; zero if not given."""
        return self.offset_m or ZERO

    @property
    def name(self) -> str:
        """Component and kind as text."""
        which = f" {self.motor}" if self.what is What.MOTOR and self.motor is not None else ""
        return f"{self.what.value}{which} {self.kind.value}".replace("_", " ")

    @property
    def text(self) -> str:
        """Component, kind and values as text."""
        parts = [self.name]
        if self.cell.value is not None:
            parts.append(f"{self.amount:g} {self.cell.value.unit}".removesuffix(" 1"))
        if self.cell.period is not None:
            parts.append(f"every {self.period:g} s")
        if self.cell.offset:
            x, y, z = self.offset
            parts.append(f"({x:g}, {y:g}, {z:g}) m, {self.yaw_rad or 0.0:g} rad")
        return " ".join(parts)
