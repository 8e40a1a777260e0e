"""Judges the parameters of a vehicle by the rules for its release; pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.preflight.table import Asked, Needs, Severity, Table, minor

_TYPE = "FIRMWARE_VERSION_TYPE"


class Level(Enum):
    """Severity of a finding."""

    OK = "ok"
    INFO = "info"  # works, could work better
    NOTE = "note"  # information for the operator
    UNSAFE = "UNSAFE"  # does not arm, unless accepted by name
    ACCEPTED = "accepted"  # unsafe, and accepted by name


_LEVEL_OF = {Severity.UNSAFE: Level.UNSAFE, Severity.NOTE: Level.NOTE, Severity.INFO: Level.INFO}


@dataclass(frozen=True, slots=True)
class Finding:
    """Result for one parameter."""

    name: str
    level: Level
    value: float | None  # in the vehicle's unit; None: missing
    unit: str
    wanted: str
    why: str
    means: str  # name of the setting over all releases
    elsewhere: str  # name in other releases, with the value where it can be converted

    @property
    def shown(self) -> str:
        """Value with unit, and the names of other releases."""
        if self.value is None:
            return "missing"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.value:g}{unit}" + (f" ({self.elsewhere})" if self.elsewhere else "")

    @property
    def text(self) -> str:
        line = f"{self.name} is {self.shown}"
        return line if self.level is Level.OK else f"{line}: {self.why}; set it to {self.wanted}"


def judge(
    asked: Sequence[Asked],
    values: Mapping[str, float],
    missing: Mapping[str, str],
    needs: Needs,
    accepted: Collection[str],
) -> list[Finding]:
    """Judge all parameters of the vehicle's release.

    ``values``: received, by name; ``missing``: reasons of the others, by name; ``accepted``: names, of any
    release, that the operator has accepted with any value.
    """
    found = (_finding(each, values.get(each.name.name), missing, needs, accepted) for each in asked)
    return [finding for finding in found if finding is not None]


def _finding(
    asked: Asked, value: float | None, missing: Mapping[str, str], needs: Needs, accepted: Collection[str]
) -> Finding | None:
    name, rule = asked.name, asked.rule
    wanted, why, level = rule.wanted_in(name, needs), rule.text, Level.OK
    if value is None:
        severity = rule.missing or rule.severity
        if severity is Severity.IGNORED:
            return None
        level, why = _LEVEL_OF[severity], f"{missing.get(name.name, 'not asked')}; {why}"
    elif rule.stops_motors(value * name.scale):
        level, why = Level.UNSAFE, "in the air the motors stop"
    elif not rule.safe(value * name.scale, needs):
        level = _LEVEL_OF[rule.severity]
    if level is Level.UNSAFE and {name.name, *(other.name for other, _ in asked.others)} & set(accepted):
        level = Level.ACCEPTED
    why = "" if level is Level.OK else why
    return Finding(name.name, level, value, name.unit, wanted, why, rule.means, asked.elsewhere(value))


class Release(NamedTuple):
    """Firmware release of a vehicle from AUTOPILOT_VERSION."""

    major: int
    minor: int
    patch: int
    kind: str  # dev, alpha, beta, rc; empty: a release

    @property
    def text(self) -> str:
        """As ``1.16.0 beta``."""
        return f"{self.major}.{self.minor}.{self.patch} {self.kind}".rstrip()


def release_of(message: Message) -> Release:
    version = message.flight_sw_version
    entry = dialect.enums[_TYPE].get(version & 0xFF)
    kind = entry.name.removeprefix(f"{_TYPE}_").lower() if entry is not None else f"type {version & 0xFF}"
    numbers = (version >> 24 & 0xFF, version >> 16 & 0xFF, version >> 8 & 0xFF)
    return Release(*numbers, kind.replace("official", ""))


class Choice(NamedTuple):
    """The rules that apply to a vehicle."""

    release: str  # release of the table
    problem: str | None  # why the vehicle may not fly, or None
    note: str | None  # information for the operator


def choose(table: Table, release: Release | None, silence: str, *, accept: bool) -> Choice:
    """Choose the rules of a release; of the nearest one for an unknown release.

    ``release``: None: not received, for the reason ``silence``; ``accept``: allow an unknown release.
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
