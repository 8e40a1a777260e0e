"""Judges the parameters of an autopilot before a flight; says what is unsafe, and changes nothing. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from flightstack.core.types import Vec3


class Level(Enum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"  # a person should know
    UNSAFE = "UNSAFE"  # does not arm, unless accepted by name
    ACCEPTED = "accepted"  # unsafe, and accepted by name


class Needs(NamedTuple):
    """What the flight needs of its autopilot."""

    velocity_max_m_s: Vec3  # command box
    altitude_max_m: float  # above the ground
    takeoff_height_m: float
    acceleration_max_m_s2: Vec3  # of the wanted velocity, ENU
    system_id: int = 1  # of the vehicle, and so of the companion, which shares it

    @property
    def horizontal_m_s(self) -> float:
        """Longest horizontal velocity that may be commanded."""
        x, y, _ = self.velocity_max_m_s
        return math.hypot(x, y)

    @property
    def horizontal_m_s2(self) -> float:
        """Largest horizontal acceleration of the wanted velocity."""
        x, y, _ = self.acceleration_max_m_s2
        return math.hypot(x, y)


Values = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Rule:
    """One parameter: what it has to be for this flight, and why."""

    name: str
    safe: Callable[[float, Needs], bool]
    wanted: Callable[[Needs], str]
    why: str  # what happens otherwise
    level: Level = Level.UNSAFE  # of a value that is not safe, and of a value that does not come


@dataclass(frozen=True, slots=True)
class Finding:
    """What became of one rule."""

    name: str
    level: Level
    value: float | None
    wanted: str
    why: str

    @property
    def text(self) -> str:
        """In one line."""
        value = "missing" if self.value is None else f"{self.value:g}"
        line = f"{self.name} is {value}"
        return line if self.level is Level.OK else f"{line}: {self.why}; set it to {self.wanted}"


def judge(
    rules: Sequence[Rule], values: Values, missing: Mapping[str, str], needs: Needs, accepted: Collection[str]
) -> list[Finding]:
    """Judge all rules.

    Args:
        rules: of the autopilot.
        values: parameters that have come.
        missing: those that have not, and why.
        needs: of the flight.
        accepted: names that a person has accepted, whatever they are set to.
    """
    return [_finding(rule, values.get(rule.name), missing, needs, accepted) for rule in rules]


def _finding(
    rule: Rule, value: float | None, missing: Mapping[str, str], needs: Needs, accepted: Collection[str]
) -> Finding:
    wanted = rule.wanted(needs)
    if value is not None and rule.safe(value, needs):
        return Finding(rule.name, Level.OK, value, wanted, "")
    level = Level.ACCEPTED if rule.level is Level.UNSAFE and rule.name in accepted else rule.level
    why = rule.why if value is not None else f"{missing.get(rule.name, 'not asked')}; {rule.why}"
    return Finding(rule.name, level, value, wanted, why)
