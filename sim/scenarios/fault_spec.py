"""One fault of a scenario, ``[[fault]]``: what fails, how, from when to when."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from flightstack.common.strict_toml import ConfigError, Each, span
from flightstack.core.types import ZERO, Vec3
from sim.scenarios.fault_table import TABLE, Cell, Kind, Number, What


class After(Enum):
    """What ``start_s`` counts from."""

    TIME = "time"  # the beginning of the run
    TAKEOFF = "takeoff"  # the vehicle's first flight; at once for a start in hover
    LANDING = "landing"  # the phase of the onboard process in which the landing begins


# the vehicle does not know the phases of the onboard process, nor the robot when the vehicle takes off
ALLOWED_AFTER: dict[bool, tuple[After, ...]] = {
    True: (After.TIME, After.LANDING),  # faults of the robot
    False: (After.TIME, After.TAKEOFF),  # faults of the vehicle
}


@dataclass(frozen=True, slots=True)
class Fault:
    """What fails, how, from when to when; the numbers that may be given depend on what and how.

    Raises ConfigError: a combination that does not exist, a number that is missing, not taken or out of
    range.
    """

    what: What
    kind: Kind
    start_s: Annotated[float, span(0.0, 3600.0)] = 0.0
    after: After = After.TIME
    duration_s: Annotated[float, span(0.001, 3600.0)] | None = None  # None: to the end of the run
    motor: Annotated[int, span(1, 4)] | None = None  # 1 to 4 as the firmware counts
    value: float | None = None  # unit and range by what and kind
    period_s: float | None = None
    offset_m: Each[Annotated[float, span(-100.0, 100.0)]] | None = None  # ENU
    yaw_rad: Annotated[float, span(-3.15, 3.15)] | None = None

    def __post_init__(self) -> None:
        kinds = TABLE[self.what]
        if self.kind not in kinds:
            names = ", ".join(sorted(k.value for k in kinds))
            raise ConfigError(f"kind: found '{self.kind.value}', {self.what.value} allows: {names}")
        cell = self.cell
        _check_number("value", self.value, cell.value, self.name)
        _check_number("period_s", self.period_s, cell.period, self.name)
        if self.kind is Kind.INTERMITTENT and self.amount >= self.period:
            raise ConfigError(
                f"period_s: found {self.period:g}, it must exceed the pause's length, value = {self.amount:g}"
            )
        if not cell.offset and (self.offset_m is not None or self.yaw_rad is not None):
            raise ConfigError(f"offset_m, yaw_rad: {self.name} takes neither; kind 'wrong' of a state does")
        if cell.offset and self.offset_m is None and self.yaw_rad is None:
            raise ConfigError(f"{self.name}: offset_m, yaw_rad or both are needed")
        if self.what is not What.MOTOR and self.motor is not None:
            raise ConfigError(f"motor: {self.name} takes none")
        if self.what is What.MOTOR and self.motor is None:
            raise ConfigError("motor: missing; which one, 1 to 4?")
        allowed = ALLOWED_AFTER[self.of_the_robot]
        if self.after not in allowed:
            names = ", ".join(a.value for a in allowed)
            raise ConfigError(f"after: found '{self.after.value}', {self.what.value} allows: {names}")
        if self.duration_s is not None and not cell.healable:
            raise ConfigError(f"duration_s: {self.name} cannot end; leave it out")

    @property
    def of_the_robot(self) -> bool:
        """Whether the ground robot carries it out, not the vehicle."""
        return self.what in (What.TARGET_ODOMETRY, What.ROBOT)

    @property
    def cell(self) -> Cell:
        """Its row of the table."""
        return TABLE[self.what][self.kind]

    @property
    def amount(self) -> float:
        """``value``, or its default; 0 where there is none."""
        return _or_default(self.value, self.cell.value)

    @property
    def period(self) -> float:
        """``period_s``, or its default, s."""
        return _or_default(self.period_s, self.cell.period)

    @property
    def offset(self) -> Vec3:
        """``offset_m``, ENU, m; zero where none was given."""
        return self.offset_m or ZERO

    @property
    def name(self) -> str:
        """What and how, in words."""
        which = f" {self.motor}" if self.what is What.MOTOR and self.motor is not None else ""
        return f"{self.what.value}{which} {self.kind.value}".replace("_", " ")

    @property
    def text(self) -> str:
        """What, how and how much, in words."""
        parts = [self.name]
        if self.cell.value is not None:
            parts.append(f"{self.amount:g} {self.cell.value.unit}".removesuffix(" 1"))
        if self.cell.period is not None:
            parts.append(f"every {self.period:g} s")
        if self.cell.offset:
            x, y, z = self.offset
            parts.append(f"({x:g}, {y:g}, {z:g}) m, {self.yaw_rad or 0.0:g} rad")
        return " ".join(parts)


def _check_number(key: str, found: float | None, allowed: Number | None, name: str) -> None:
    if found is None:
        return
    if allowed is None:
        raise ConfigError(f"{key}: {name} takes none")
    if not allowed.low <= found <= allowed.high:
        unit = "" if allowed.unit == "1" else f" {allowed.unit}"
        raise ConfigError(
            f"{key}: found {found:g}, {name} allows {allowed.low:g} to {allowed.high:g}{unit} "
            f"({allowed.meaning})"
        )


def _or_default(found: float | None, number: Number | None) -> float:
    if found is not None:
        return found
    return number.default if number is not None else 0.0
