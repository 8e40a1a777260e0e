"""Scenarios of teams: vehicles in one room, each with its robot, or all with one. One vehicle is a team too.

A file names the scenario that all members share (``base``), then what the team has instead, in the tables of
a scenario, and then what each member has instead, in tables ``[[member]]``. So every key of a scenario can be
set for all members or for one. Files that come with the package are in ``sim/scenarios/teams``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from flightstack.common.strict_toml import (
    ConfigError,
    Files,
    dumps,
    from_table,
    over,
    parse_toml,
    read_toml,
    span,
    to_table,
)
from flightstack.config import files as configurations
from flightstack.core.fleet.assignment import assign
from flightstack.core.types import Vec3
from logs.schema.names import OWN, Names, member_name
from sim.chance import member as seed_of
from sim.chance import stream
from sim.scenarios import scenario as scenarios
from sim.scenarios.scenario import PathKind, Scenario, StartKind, TargetSpec

_PARALLEL = 1e-9  # sine of the angle of two lines
MEMBERS_MAX = 250  # each has a MAVLink system id of its own
_OF_THE_TEAM = ("name", "description", "exchange", "assignment", "one_target")  # others: of a scenario


@dataclass(frozen=True, slots=True)
class ExchangeLink:
    """Link of the messages that the companions send each other every tick: at least one tick late."""

    delay_s: Annotated[float, span(0.0, 1.0)] = 0.0
    loss: Annotated[float, span(0.0, 1.0)] = 0.0  # probability for each message and receiver
    # numbers of members whose messages are lost ...
    silent: tuple[Annotated[int, span(1, MEMBERS_MAX)], ...] = ()
    apart: tuple[
        Annotated[int, span(1, MEMBERS_MAX)], ...
    ] = ()  # ... or that exchange messages among themselves only ...
    broken_from_s: Annotated[float, span(0.0, 3600.0)] = 0.0  # ... from this time of the flight on


class Assignment(Enum):
    """Who lands on which robot."""

    FIXED = "fixed"  # each on that of its own table
    START = "start"  # least sum of the horizontal distances from the start positions


@dataclass(frozen=True, slots=True)
class TeamScenario:
    """Vehicles that fly at once; number n, counted from 1, is called cf<n> and has system id n."""

    name: str
    description: str
    member: tuple[Scenario, ...]
    exchange: ExchangeLink = field(default_factory=ExchangeLink)
    assignment: Assignment = Assignment.FIXED  # ``load`` assigns, so that what it returns is fixed
    one_target: bool = False  # all land on one robot: theirs have one seed, and so are the same bits

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
        """Refuse a robot of all members that is not the same for each of them, at each time.

        Raises ConfigError: which key, and what is allowed.
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

    @property
    def is_alone(self) -> bool:
        """Whether there is one vehicle."""
        return len(self.member) == 1

    def names(self, number: int) -> Names:
        """Names in the log of a vehicle: without its own where it is alone."""
        return OWN if self.is_alone else Names(member_name(number), number)

    @property
    def rate_hz(self) -> int:
        """Ticks in a second, of all members."""
        return self.member[0].onboard.loop.rate_hz

    def with_filter(self, name: str) -> TeamScenario:
        """Return the same team, all members with another safety filter.

        Raises ConfigError: no name of a filter, or the filter refuses the configuration.
        """
        return replace(self, member=tuple(each.with_filter(name) for each in self.member))

    def starts_enu_m(self) -> list[Vec3]:
        """Where members begin in the air, of those whose place is given, m."""
        found = []
        for number, each in enumerate(self.member, 1):
            start, target = each.start, each.target
            drawn = target.random_heading and target.pad_behind_axle_m
            if start.kind is StartKind.HOVER and start.offset_m is not None and not drawn:
                found.append(_start_m(each, _pad_m(target, ""), number))
        return found

    def pads_apart_m(self) -> float:
        """Least distance that two pads can come to: of places and straight lines; 0 where paths may meet."""
        lines = [_line(each.target) for each in self.member]
        return min((_apart_m(*two) for two in combinations(lines, 2)), default=math.inf)

    def target_seed(self, seed: int) -> int | None:
        """Seed of the one robot of all members, that of the first one; None: each robot has its member's."""
        return seed_of(seed, 1) if self.one_target else None

    def singles(self, seed: int) -> Iterator[tuple[Scenario, int]]:
        """Yield scenario and seed of each member; a member that no other comes near flies as with them alone.

        A room has one mean wind; its direction is drawn from the team's seed where a member gives none.
        Gusts are each member's own.
        """
        if self.is_alone:
            yield self.member[0], seed
            return
        drawn_rad = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
        for number, each in enumerate(self.member, 1):
            if each.wind.direction_rad is None:
                each = replace(each, wind=replace(each.wind, direction_rad=drawn_rad))
            yield each, seed_of(seed, number)

    def one(self, seed: int, number: int | None) -> tuple[Scenario, int]:
        """Scenario and seed of one vehicle.

        ``seed``: of the team; ``number``: of the vehicle; None: there is only one.
        Raises ConfigError, with found and allowed value.
        """
        members = list(self.singles(seed))
        if number is None and len(members) == 1:
            number = 1
        if number is None or not 1 <= number <= len(members):
            what = "missing" if number is None else f"found {number}"
            raise ConfigError(f"--member: {what}; allowed are 1 to {len(members)} of {self.name}")
        return members[number - 1]


_FILES = Files(TeamScenario, "sim.scenarios.teams", "team")
names = _FILES.names


def alone(scenario: Scenario) -> TeamScenario:
    """The scenario of one vehicle as a team of one."""
    return TeamScenario(scenario.name, scenario.description, (scenario,))


def path_of(name_or_file: str | Path) -> Path:
    """File of a scenario, of one vehicle or of several, by name or path.

    Raises ConfigError: neither a known name nor a file.
    """
    if name_or_file in names():
        return _FILES.path_of(name_or_file)
    if name_or_file in scenarios.names() or Path(name_or_file).is_file():
        return scenarios.path_of(name_or_file)
    known = f"{', '.join(scenarios.names())}; of several vehicles: {', '.join(names())}"
    raise ConfigError(f"scenario {str(name_or_file)!r}: neither a file nor one of: {known}")


def load(name_or_file: str | Path) -> TeamScenario:
    """Load a scenario by name or path; that of one vehicle is a team of one.

    Raises ConfigError, with file, key, found and allowed value.
    """
    path = path_of(name_or_file)
    table = read_toml(path)
    if "member" not in table and name_or_file not in names():
        return alone(scenarios.load(name_or_file))
    try:
        team = assigned(_team(path, table))
        return replace(team, member=tuple(scenarios.in_place(each, path.parent) for each in team.member))
    except ConfigError as error:
        found = str(error)
        raise ConfigError(found if found.startswith(str(path)) else f"{path}: {found}") from None


def from_text(toml: str) -> TeamScenario:
    """Scenario from text in which nothing is left to a base.

    Raises ConfigError, with key, found and allowed value.
    """
    table = parse_toml(toml.encode())
    return _team(Path(), table) if "member" in table else alone(from_table(Scenario, table))


def text(team: TeamScenario) -> str:
    """Return a scenario as a file in which nothing is left to a base."""
    if team.is_alone:
        return dumps(team.member[0])
    table = to_table(team)
    for member in table["member"]:
        for key in ("name", "description"):  # they follow from the team's
            del member[key]
    return dumps(table)


def assigned(team: TeamScenario) -> TeamScenario:
    """The same team with its robots assigned, and nothing left to be assigned.

    Each vehicle keeps its start; robot and odometry of another member's tables become its own.

    Raises ConfigError: a start or a pad has no place before chance is drawn.
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
    """Middle of a robot's pad at time zero, ENU, m; without heave."""
    (x, y), behind_m = target.position_m, target.pad_behind_axle_m
    if behind_m and target.random_heading:
        raise ConfigError(
            f"{where}: target.random_heading: found true, with a pad behind the axle its place is drawn by "
            'chance; give target.heading_rad, or assignment = "fixed"'
        )
    c, s = math.cos(target.heading_rad), math.sin(target.heading_rad)
    return (x - behind_m * c, y - behind_m * s, target.pad_height_m)


# a place on the floor, and the direction of the line through it that a pad stays on; (0, 0): it stands
_Line = tuple[tuple[float, float], tuple[float, float]]


def _line(target: TargetSpec) -> _Line | None:
    """Line that a robot's pad stays on; None: it may be anywhere."""
    stands = target.path is PathKind.STILL or target.speed_m_s == 0.0 == target.turn_rate_rad_s
    behind = bool(target.pad_behind_axle_m)
    if (target.random_heading and (behind or not stands)) or (target.turn_rate_rad_s and not stands):
        return None
    x, y, _ = _pad_m(target, "")
    return (x, y), (0.0, 0.0) if stands else (math.cos(target.heading_rad), math.sin(target.heading_rad))


def _apart_m(one: _Line | None, other: _Line | None) -> float:
    """Least distance of two lines or places."""
    if one is None or other is None:
        return 0.0
    (ax, ay), (ux, uy), (bx, by), (vx, vy) = *one, *other
    if abs(ux * vy - uy * vx) > _PARALLEL:
        return 0.0
    x, y = bx - ax, by - ay
    cx, cy = (ux, uy) if (ux, uy) != (0.0, 0.0) else (vx, vy)
    return abs(x * cy - y * cx) if (cx, cy) != (0.0, 0.0) else math.hypot(x, y)


def _start_m(scenario: Scenario, pad_m: Vec3, number: int) -> Vec3:
    """Where a vehicle begins, ENU, m."""
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
    members = table.pop("member", [])
    if not isinstance(members, list) or not all(isinstance(each, dict) for each in members):
        raise ConfigError(f"member: found {members!r}, allowed: tables [[member]], one for each vehicle")
    about: dict[str, Any] = {key: table.pop(key) for key in _OF_THE_TEAM if key in table}
    shared = scenarios.FILES.over_base(path, table)
    found: list[dict[str, Any]] = []
    for number, own in enumerate(members, 1):
        for key in (*_OF_THE_TEAM, "base"):
            if key in own:
                raise ConfigError(f"member {number}: {key}: found {own[key]!r}; the team has it, remove it")
        one = scenarios.one_pad(over(_configured(path, shared, own, number), own))
        one["name"], one["description"] = f"{about.get('name')}.cf{number}", ""
        found.append(_checked(one, f"member {number}"))
    return from_table(TeamScenario, {**about, "member": found})


def _configured(path: Path, shared: dict[str, Any], own: dict[str, Any], number: int) -> dict[str, Any]:
    """What a member shares; with ``config`` that configuration takes the place of the onboard processes' one.

    Table [fleet], tick, and the place where landings begin stay those of the team.
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
    """The same table, if it is that of a scenario; or else the error says of which member."""
    try:
        from_table(Scenario, table)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    return table
