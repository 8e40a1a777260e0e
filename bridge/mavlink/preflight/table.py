"""Rules for an autopilot's parameters by release, read from a TOML file, and their evaluation."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Literal, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.profiles import PROFILES
from flightstack.common.strict_toml import Files

_SLACK = 1e-6  # relative tolerance of a parameter in single precision


class Needs(NamedTuple):
    horizontal_m_s: float  # maximum horizontal velocity command, m/s
    vertical_m_s: float
    horizontal_m_s2: float  # maximum horizontal acceleration of the commanded velocity, m/s2
    vertical_m_s2: float
    altitude_max_m: float  # maximum height of the flight above the ground, m
    system_id: int = 1  # MAVLink system id of the vehicle and its companion


# limit of a rule: a number, or the name of the field of ``Needs`` that has the number
Bound = float | Literal[
    "horizontal_m_s", "vertical_m_s", "horizontal_m_s2", "vertical_m_s2", "altitude_max_m", "system_id"
]  # fmt: skip


class Level(Enum):
    """Result of a rule; the level in a rule is the result for an unsafe or missing value."""

    OK = "ok"
    INFO = "info"  # safe, but the vehicle could perform better
    NOTE = "note"  # information for the operator
    UNSAFE = "UNSAFE"  # the vehicle is not armed, unless the operator accepts the name
    ACCEPTED = "accepted"  # unsafe, but accepted by name
    IGNORED = "ignored"  # a missing value is no finding, since not every vehicle has the parameter


@dataclass(frozen=True, slots=True)
class Name:
    """Name of a parameter in a range of releases."""

    name: str
    since: str = ""  # first release with the name; empty: the table's oldest release
    before: str = ""  # first release without the name; empty: the name still exists
    unit: str = ""
    scale: float = 1.0  # factor from the parameter's unit to the rule's unit

    def has(self, release: str) -> bool:
        """Whether a release of the table has this name."""
        number = minor(release)
        return (not self.since or minor(self.since) <= number) and (
            not self.before or number < minor(self.before)
        )


@dataclass(frozen=True, slots=True)
class Rule:
    """Requirement on one setting; numbers have the rule's unit: a value times the ``scale`` of its name."""

    means: str  # this project's name for the setting; the same for all releases of the autopilot
    names: tuple[Name, ...]
    text: str  # consequence of an unsafe value
    severity: Level = Level.UNSAFE
    missing: Level | None = None  # severity of a missing value; None: severity of the rule
    profiles: tuple[str, ...] = ()  # profiles of the file that have this rule; empty: all profiles
    stops: tuple[str, ...] = ()  # values that stop the motors in the air and are always unsafe
    wanted: str = ""  # allowed values as text, {} for the number; empty: text from the condition
    # conditions, of which exactly one is given (tested for the shipped files)
    low: Bound | None = None  # minimum allowed value; ``high``: maximum allowed value
    high: Bound | None = None
    values: tuple[str, ...] = ()  # allowed whole numbers with their meaning, such as "4 (land)"
    bits_set: int | None = None
    bits_clear: int | None = None
    # upper limit of a second allowed range, which has no lower limit
    off: float | None = None
    off_text: str = ""

    def safe(self, number: float, needs: Needs) -> bool:
        """Whether a number, in the rule's unit, is safe for a flight."""
        if self.off is not None and number <= self.off + _SLACK:
            return True
        if self.values:
            return number in _numbers(self.values)
        if self.bits_set is not None:
            return int(number) & self.bits_set == self.bits_set
        if self.bits_clear is not None:
            return not int(number) & self.bits_clear
        low, high = _number(self.low, needs), _number(self.high, needs)
        return (low is None or number >= low - _SLACK) and (high is None or number <= high + _SLACK)

    def wanted_in(self, name: Name, needs: Needs) -> str:
        """Return the required value as text, in the unit of the parameter, with two decimals, rounded up."""
        unit = f" {name.unit}" if name.unit else ""

        def own(number: float) -> str:
            return f"{math.ceil(number / name.scale * 100.0 - 1e-4) / 100.0:g}"

        low, high = _number(self.low, needs), _number(self.high, needs)
        if self.wanted:
            return self.wanted.format(own(low) if low is not None else "")
        text = " or ".join(self.values)
        if low is not None and high is not None:
            text = f"{own(low)} to {own(high)}{unit}"
        elif low is not None:
            text = f"at least {own(low)}{unit}"
        elif high is not None:
            text = f"at most {own(high)}{unit}"
        return f"{self.off_text} or {text}" if self.off is not None else text


def _number(bound: Bound | None, needs: Needs) -> float | None:
    return float(getattr(needs, bound)) if isinstance(bound, str) else bound


def _numbers(values: tuple[str, ...]) -> set[float]:
    return {float(value.split()[0]) for value in values}


class Asked(NamedTuple):
    name: Name
    rule: Rule
    names: frozenset[str]  # names of the setting in all releases


@dataclass(frozen=True, slots=True)
class Table:
    title: str
    releases: tuple[str, ...]  # known releases, the oldest first
    rule: tuple[Rule, ...]

    def asked(self, profile: str, release: str) -> tuple[Asked, ...]:
        """Return the parameters that a release, known to this table, has for a profile of this table."""
        rules = [rule for rule in self.rule if not rule.profiles or profile in rule.profiles]
        names = [(rule.means, name.name) for rule in rules for name in rule.names]
        return tuple(
            Asked(name, rule, frozenset(other for means, other in names if means == rule.means))
            for rule in rules
            for name in rule.names
            if name.has(release)
        )


def minor(release: str) -> tuple[int, int]:
    """Return major and minor number of a release such as ``4.7``. Raises ValueError: not MAJOR.MINOR."""
    major, dot, number = release.partition(".")
    if not (dot and major.isdecimal() and number.isdecimal()):
        raise ValueError(f"found {release!r}, a release such as '4.7' is needed")
    return int(major), int(number)


_FILES = Files(Table, "bridge.mavlink.preflight", "rules")


@cache
def table(profile: str) -> Table | None:
    """Return the rules of a profile; None for a profile without parameters. Raises ConfigError: bad file."""
    file = PROFILES[profile].rules
    return _FILES.load(file) if file is not None else None


_TYPE = "FIRMWARE_VERSION_TYPE"


@dataclass(frozen=True, slots=True)
class Finding:
    name: str
    level: Level
    value: float | None  # value of the parameter in the vehicle's unit; None: missing
    unit: str
    wanted: str
    why: str
    means: str  # name of the setting, the same for all releases

    @property
    def text(self) -> str:
        value = "missing" if self.value is None else f"{self.value:g} {self.unit}".rstrip()
        line = f"{self.name} is {value}"
        return line if self.level is Level.OK else f"{line}: {self.why}; set it to {self.wanted}"


def judge(
    asked: Sequence[Asked],
    values: Mapping[str, float],
    missing: Mapping[str, str],
    needs: Needs,
    accepted: Collection[str],
) -> list[Finding]:
    """Evaluate all rules for the parameters of the vehicle's release.

    ``values``: received values by name; ``missing``: reasons for the other names; ``accepted``: names, of any
    release, whose value the operator accepts.
    """
    findings = []
    for each in asked:
        name, rule, value, why, level = each.name, each.rule, values.get(each.name.name), "", Level.OK
        if value is None:
            level, why = rule.missing or rule.severity, f"{missing.get(name.name, 'not asked')}; {rule.text}"
        elif value * name.scale in _numbers(rule.stops):
            level, why = Level.UNSAFE, "in the air the motors stop"
        elif not rule.safe(value * name.scale, needs):
            level, why = rule.severity, rule.text
        if level is Level.UNSAFE and each.names & set(accepted):
            level = Level.ACCEPTED
        if level is not Level.IGNORED:
            wanted = rule.wanted_in(name, needs)
            findings.append(Finding(name.name, level, value, name.unit, wanted, why, rule.means))
    return findings


class Release(NamedTuple):
    major: int
    minor: int
    patch: int
    kind: str  # kind of build: dev, alpha, beta, rc; empty: official release

    @property
    def text(self) -> str:
        return f"{self.major}.{self.minor}.{self.patch} {self.kind}".rstrip()


def release_of(message: Message) -> Release:
    version = message.flight_sw_version
    entry = dialect.enums[_TYPE].get(version & 0xFF)
    kind = entry.name.removeprefix(f"{_TYPE}_").lower() if entry is not None else f"type {version & 0xFF}"
    numbers = (version >> 24 & 0xFF, version >> 16 & 0xFF, version >> 8 & 0xFF)
    return Release(*numbers, kind.replace("official", ""))


class Choice(NamedTuple):
    release: str | None  # release whose rules apply; None: no rules apply
    problem: str | None  # reason why the vehicle may not fly, or None
    note: str | None  # information for the operator, or None


def choose(table: Table, release: Release | None, silence: str, *, accept: bool) -> Choice:
    """Choose the rules of a release, or of the nearest known release if it is unknown.

    ``release`` None: no release was received, because of ``silence``; ``accept``: allow an unknown release.
    """
    newest, oldest = table.releases[-1], table.releases[0]
    number = (release.major, release.minor) if release is not None else (0, 0)
    below = [each for each in table.releases if minor(each) <= number]
    nearest = newest if number == (0, 0) else (below or [oldest])[-1]
    if release is not None and minor(nearest) == number:
        short = f"{table.title} {release.text} is not a release: judged by the rules of {nearest}"
        return Choice(nearest, None, short if release.kind else None)
    if release is None:
        what = f"the release of this {table.title} is not known: {silence}"
    elif number == (0, 0):
        what = f"{table.title} {release.text} is a version without a number (a build without tags?)"
    else:
        what = f"the parameters of {table.title} {release.text} are not known"
    if accept:
        return Choice(nearest, None, f"{what}; judged by the rules of {nearest} (--accept-release)")
    known = f"known are {oldest} to {newest}"
    return Choice(nearest, f"{what}; {known}; --accept-release flies it by the rules of {nearest}", None)
