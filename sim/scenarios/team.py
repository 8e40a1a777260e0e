"""Scenarios: lists of vehicles in one room, each with its robot, or all with one robot.

The tables of a scenario's file apply to all vehicles, a table ``[[member]]`` to one vehicle: every key can be
set for all or for one. A file without ``[[member]]`` has one vehicle. ``sim/scenarios/teams`` has the
package's files with several vehicles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from flightstack import config as configurations
from flightstack.common.strict_toml import (
    ConfigError,
    Files,
    dumps,
    from_table,
    not_found,
    over,
    parse_toml,
    read_toml,
    span,
    to_table,
)
from flightstack.common.text import labels
from flightstack.core.fleet.assignment import assign
from flightstack.core.types import Vec3
from logs.schema import member_name
from sim.chance import member as seed_of
from sim.chance import stream
from sim.scenarios import scenario as scenarios
from sim.scenarios.scenario import PathKind, Scenario, StartKind, TargetSpec

_PARALLEL = 1e-9  # sine of the angle below which two lines count as parallel
MEMBERS_MAX = 250  # maximum number of members, because each has a MAVLink system id
_OF_THE_TEAM = ("name", "description", "exchange", "assignment", "one_target")  # keys that only a team has


@dataclass(frozen=True, slots=True)
class ExchangeLink:
    """Link of the messages that companions send to each other every tick; the delay is at least one tick."""

    delay_s: Annotated[float, span(0.0, 1.0)] = 0.0
    loss: Annotated[float, span(0.0, 1.0)] = 0.0  # probability of loss for each message and receiver
    # numbers of members whose messages are lost from broken_from_s on
    silent: tuple[Annotated[int, span(1, MEMBERS_MAX)], ...] = ()
    # numbers of members that exchange messages only among themselves from broken_from_s on
    apart: tuple[Annotated[int, span(1, MEMBERS_MAX)], ...] = ()
    broken_from_s: Annotated[float, span(0.0, 3600.0)] = 0.0  # time from which these links are broken


class Assignment(Enum):
    """Assignment of vehicles to robots."""

    FIXED = "fixed"  # each vehicle lands on the robot of its own table
    START = "start"  # the assignment with the smallest sum of horizontal distances from the starts


@dataclass(frozen=True, slots=True)
class TeamScenario:
    """Vehicles that fly together; vehicle n, counted from 1, has the name cf<n> and system id n."""

    name: str
    description: str
    member: tuple[Scenario, ...]
    exchange: ExchangeLink = field(default_factory=ExchangeLink)
    assignment: Assignment = Assignment.FIXED  # ``load`` assigns robots and returns FIXED
    one_target: bool = False  # all land on one robot: its copies have one seed, so they move alike

    def __post_init__(self) -> None:
        if not 1 <= len(self.member) <= MEMBERS_MAX:
            raise ConfigError(
                f"member: found {len(self.member)}, allowed: 1 to {MEMBERS_MAX} tables [[member]]; "
                "write one for each vehicle"
            )
        rates = {each.onboard.loop.rate_hz for each in self.member}
        if len(rates) > 1:
            found = ", ".join(f"{rate:g}" for rate in sorted(rates))
            raise ConfigError(
                f"member: onboard.loop.rate_hz: found {found}; all members have the same ticks, so give the "
                "rate once, in [onboard.loop]"
            )
        if self.one_target:
            self._check_target()

    def _check_target(self) -> None:
        """Check that a common robot is the same for all members at each time.

        Raises ConfigError: names the key and the allowed value.
        """
        first = self.member[0]
        for number, each in enumerate(self.member, 1):
            for key in ("target", "odometry"):
                if getattr(each, key) != getattr(first, key):
                    raise ConfigError(
                        f"member {number}: {key}: found another one than the first member's; with one_target "
                        f"all have the same robot: give it once, in [{key}]"
                    )
            if any(fault.of_the_robot for fault in each.fault):
                raise ConfigError(
                    f"member {number}: fault: found one of the robot; with one_target the robot has none"
                )
        if first.target.wait_for_landing:
            raise ConfigError(
                "target.wait_for_landing: found true; with one_target the robot drives at once: set it false"
            )

    @classmethod
    def of(cls, scenario: Scenario) -> TeamScenario:
        """Return the scenario of one vehicle as a team with one member."""
        return cls(scenario.name, scenario.description, (scenario,))

    def namespaces(self, first: str = "cf1") -> dict[int, str]:
        """Return the namespaces of the vehicles by number; ``first``: namespace of the first vehicle."""
        return {1: first} | {number: member_name(number) for number in range(2, len(self.member) + 1)}

    @property
    def rate_hz(self) -> int:
        """Number of ticks per second, equal for all members."""
        return self.member[0].onboard.loop.rate_hz

    @property
    def exchanges(self) -> bool:
        """Whether the vehicles send messages to each other."""
        return any(each.onboard.fleet is not None for each in self.member)

    def with_filter(self, name: str) -> TeamScenario:
        """Return this team with the safety filter ``name`` for all members.

        Raises ConfigError: no such filter, or the filter rejects the configuration.
        """
        return replace(self, member=tuple(each.with_filter(name) for each in self.member))

    def starts_enu_m(self) -> list[Vec3]:
        """Return the start positions of members that start in the air at a given position, ENU, m."""
        found = []
        for number, each in enumerate(self.member, 1):
            start, target = each.start, each.target
            drawn = target.random_heading and target.pad_behind_axle_m
            if start.kind is StartKind.HOVER and start.offset_m is not None and not drawn:
                found.append(_start_m(each, _pad_m(target, ""), number))
        return found

    def pads_apart_m(self) -> float:
        """Return the smallest possible distance of two pads, m; 0 if their paths may meet."""
        lines = [_line(each.target) for each in self.member]
        return min((_apart_m(*two) for two in combinations(lines, 2)), default=math.inf)

    def target_seed(self, seed: int) -> int | None:
        """Return the seed of the common robot, the first member's; None: each robot has its own seed."""
        return seed_of(seed, 1) if self.one_target else None

    def singles(self, seed: int) -> Iterator[tuple[Scenario, int]]:
        """Yield scenario and seed of each member; alone, it flies as with these if no other comes near.

        A room has one mean wind; its direction is drawn from the team's seed if a member gives none. Gusts
        differ for each member. A single vehicle has the seed of the run.
        """
        if len(self.member) == 1:
            yield self.member[0], seed
            return
        drawn_rad = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
        for number, each in enumerate(self.member, 1):
            if each.wind.direction_rad is None:
                each = replace(each, wind=replace(each.wind, direction_rad=drawn_rad))
            yield each, seed_of(seed, number)

    def one(self, seed: int, number: int | None) -> tuple[Scenario, int]:
        """Return scenario and seed of one vehicle.

        ``seed``: seed of the team; ``number``: number of the vehicle; None: the only vehicle.
        Raises ConfigError, with found and allowed value.
        """
        members = list(self.singles(seed))
        chosen = members if number is None else members[number - 1 : number]
        if len(chosen) != 1:
            what = "missing" if number is None else f"found {number}"
            raise ConfigError(f"--member: {what}; allowed are 1 to {len(members)} of {self.name}")
        return chosen[0]


_FILES = Files(TeamScenario, "sim.scenarios.teams", "team")


def names() -> list[str]:
    """Return the names of the package's scenarios; scenarios with several vehicles are last."""
    return [*scenarios.names(), *_FILES.names()]


def path_of(name_or_file: str | Path) -> Path:
    """Return the file of a scenario by name or path. Raises ConfigError: neither a known name nor a file."""
    if name_or_file in _FILES.names():
        return _FILES.path_of(name_or_file)
    if name_or_file in scenarios.names() or Path(name_or_file).is_file():
        return scenarios.path_of(name_or_file)
    raise not_found("scenario", name_or_file, names())


def load(name_or_file: str | Path) -> TeamScenario:
    """Load a scenario by name or path.

    Raises ConfigError, with file, key, found and allowed value.
    """
    path = path_of(name_or_file)
    table = read_toml(path)
    try:
        team = assigned(_team(path, table))
        return replace(team, member=tuple(scenarios.in_place(each, path.parent) for each in team.member))
    except ConfigError as error:
        found = str(error)
        raise ConfigError(found if found.startswith(str(path)) else f"{path}: {found}") from None


def from_text(toml: str) -> TeamScenario:
    """Return the scenario of a text without a base.

    Raises ConfigError, with key, found and allowed value.
    """
    return _team(Path(), parse_toml(toml.encode()))


def text(team: TeamScenario) -> str:
    """Return a scenario as the text of a complete file, without a base."""
    defaults = TeamScenario("", "", team.member)
    about = ("name", "description")
    changed = [k for k in _OF_THE_TEAM if k in about or getattr(team, k) != getattr(defaults, k)]
    table = to_table(team)
    shared, own = _in_common([{k: v for k, v in m.items() if k not in _OF_THE_TEAM} for m in table["member"]])
    return dumps({key: table[key] for key in changed} | shared | ({"member": own} if own != [{}] else {}))


def _in_common(tables: list[dict[str, Any]]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the keys that have the same value in all tables, and the remaining keys of each table."""
    shared: dict[str, Any] = {}
    own: list[dict[str, Any]] = [{} for _ in tables]
    for key in dict.fromkeys(key for table in tables for key in table):
        values = [table.get(key) for table in tables]
        if len({repr(value) for value in values}) == 1:
            shared[key] = values[0]
        elif all(isinstance(value, dict) for value in values):
            shared[key], below = _in_common([table[key] for table in tables])
            for each, rest in zip(own, below, strict=True):
                each |= {key: rest} if rest else {}
        else:
            for each, table in zip(own, tables, strict=True):
                each |= {key: table[key]} if key in table else {}
    return shared, own


def assigned(team: TeamScenario) -> TeamScenario:
    """Return this team with assigned robots, and with ``assignment`` FIXED.

    Each vehicle keeps its start and gets the robot and odometry tables of the assigned member.

    Raises ConfigError: a start or a pad has no known position, because it is drawn from the seed.
    """
    if team.assignment is Assignment.FIXED:
        return team
    pads = [_pad_m(each.target, f"member {n}") for n, each in enumerate(team.member, 1)]
    starts = [_start_m(each, pad, n) for n, (each, pad) in enumerate(zip(team.member, pads, strict=True), 1)]
    members = []
    for each, (x, y, z), k in zip(team.member, starts, assign(starts, pads), strict=True):
        start, (px, py, pz) = each.start, pads[k]
        if start.kind is StartKind.HOVER and each is not team.member[k]:
            start = replace(start, offset_m=(x - px, y - py, z - pz))
        robot = team.member[k]
        members.append(replace(each, start=start, target=robot.target, odometry=robot.odometry))
    return replace(team, member=tuple(members), assignment=Assignment.FIXED)


def _pad_m(target: TargetSpec, where: str) -> Vec3:
    """Return the centre of a robot's pad at time zero, ENU, m; without heave."""
    (x, y), behind_m = target.position_m, target.pad_behind_axle_m
    if behind_m and target.random_heading:
        raise ConfigError(
            f"{where}: target.random_heading: found true, with a pad behind the axle its place is drawn by "
            'chance; give target.heading_rad, or assignment = "fixed"'
        )
    c, s = math.cos(target.heading_rad), math.sin(target.heading_rad)
    return (x - behind_m * c, y - behind_m * s, target.pad_height_m)


# line on which a pad moves: point on the floor, and direction; direction (0, 0): the pad does not move
_Line = tuple[tuple[float, float], tuple[float, float]]


def _line(target: TargetSpec) -> _Line | None:
    """Return the line on which a robot's pad moves; None: the pad may be anywhere."""
    stands = target.path is PathKind.STILL or target.speed_m_s == 0.0 == target.turn_rate_rad_s
    behind = bool(target.pad_behind_axle_m)
    if (target.random_heading and (behind or not stands)) or (target.turn_rate_rad_s and not stands):
        return None
    x, y, _ = _pad_m(target, "")
    return (x, y), (0.0, 0.0) if stands else (math.cos(target.heading_rad), math.sin(target.heading_rad))


def _apart_m(one: _Line | None, other: _Line | None) -> float:
    """Return the smallest distance of two lines or points."""
    if one is None or other is None:
        return 0.0
    (ax, ay), (ux, uy), (bx, by), (vx, vy) = *one, *other
    if abs(ux * vy - uy * vx) > _PARALLEL:
        return 0.0
    x, y = bx - ax, by - ay
    cx, cy = (ux, uy) if (ux, uy) != (0.0, 0.0) else (vx, vy)
    return abs(x * cy - y * cx) if (cx, cy) != (0.0, 0.0) else math.hypot(x, y)


def _start_m(scenario: Scenario, pad_m: Vec3, number: int) -> Vec3:
    """Return the start position of a vehicle, ENU, m."""
    start = scenario.start
    if start.kind is StartKind.GROUND:
        return (*start.ground_position_m, 0.0)
    if start.offset_m is None:
        raise ConfigError(
            f"member {number}: start.offset_m: missing; its start is drawn by chance, after robots are "
            'assigned: give it, or assignment = "fixed"'
        )
    (x, y, z), (dx, dy, dz) = pad_m, start.offset_m
    return (x + dx, y + dy, z + dz)


def _team(path: Path, table: dict[str, Any]) -> TeamScenario:
    listed = "member" in table
    members = table.pop("member", [{}])
    if not isinstance(members, list) or not all(isinstance(each, dict) for each in members):
        raise ConfigError(f"member: found {members!r}, allowed: tables [[member]], one for each vehicle")
    whole = table if listed else scenarios.FILES.over_base(path, table)  # may have name and description
    about: dict[str, Any] = {key: whole.pop(key) for key in _OF_THE_TEAM if key in whole}
    shared = scenarios.FILES.over_base(path, whole)
    found: list[dict[str, Any]] = []
    names = labels([member_name(number) for number in range(1, len(members) + 1)])
    for number, (own, label) in enumerate(zip(members, names, strict=True), 1):
        for key in (*_OF_THE_TEAM, "base"):
            if key in own:
                raise ConfigError(f"member {number}: {key}: found {own[key]!r}; the team has it, remove it")
        one = scenarios.one_pad(over(_configured(path, shared, own, number), own))
        one |= {key: about[key] for key in ("name", "description") if key in about}
        if label:
            one |= {"name": f"{about.get('name')}.{label}", "description": ""}
        found.append(_checked(one, f"member {number}: " if listed else ""))
    return from_table(TeamScenario, {**about, "member": found})


def _configured(path: Path, shared: dict[str, Any], own: dict[str, Any], number: int) -> dict[str, Any]:
    """Return the shared tables for a member; its ``config`` replaces the shared onboard configuration.

    The team's values of [fleet], the tick rate and the start of landings remain.
    """
    if "config" not in own:
        return shared
    onboard = shared.get("onboard", {})
    kept = {key: onboard[key] for key in ("fleet", "loop") if key in onboard}
    if "start_offset_m" in (takeoff := onboard.get("takeoff", {})):
        kept["takeoff"] = {"start_offset_m": takeoff["start_offset_m"]}
    file = configurations.FILES.named(path, f"member {number}: config", own.pop("config"))
    return {**shared, "onboard": over(configurations.FILES.table(file), kept)}


def _checked(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the table if it is a valid scenario; else raise an error that names the member."""
    try:
        from_table(Scenario, table)
    except ConfigError as error:
        raise ConfigError(f"{where}{error}") from None
    return table
