"""A scenario: everything that determines a simulated run, except the seed.

A run is a list of vehicles in one room, each with its robot, or all with one robot; the ordinary list has one
vehicle. ``sim/scenarios`` has one TOML file for each scenario. The tables of a file apply to all vehicles, a
table ``[[member]]`` applies to one vehicle: every key can be set for all vehicles or for one vehicle. A file
without ``[[member]]`` has one vehicle. A scenario is loaded by name or path; unknown keys are rejected.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

from flightstack import config as configurations
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
from flightstack.core.parameters.filters import look_here
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3
from logs.schema import member_name
from sim.chance import member as seed_of
from sim.chance import stream
from sim.scenarios.fault_spec import Fault
from sim.scenarios.tables import (
    MEMBERS_MAX,
    ExchangeLink,
    Judge,
    Start,
    StartKind,
    TargetLink,
    TargetSpec,
    VehicleSpec,
    Wind,
    apart_m,
)

_OF_THE_RUN = ("name", "description", "exchange", "one_target")  # keys that no member has


@dataclass(frozen=True, slots=True)
class Scenario:
    """A vehicle with its robot, and the ``others`` that fly in the same room.

    Vehicle n, counted from 1, has the name cf<n> and system id n.
    """

    name: str  # name of the scenario; with `base` its default is the name of the file
    description: str  # purpose of the scenario in one sentence
    onboard: FlightConfig
    # time limit of a flight, after which the flight aborts
    duration_max_s: Annotated[float, span(1.0, 3600.0)] = 120.0
    start: Start = field(default_factory=Start)
    target: TargetSpec = field(default_factory=TargetSpec)
    odometry: TargetLink = field(default_factory=TargetLink)
    vehicle: VehicleSpec = field(default_factory=VehicleSpec)
    wind: Wind = field(default_factory=Wind)
    judge: Judge | None = None  # barrier of the verdict; None: the flown barrier
    fault: tuple[Fault, ...] = ()  # tables [[fault]], in any order
    exchange: ExchangeLink = field(default_factory=ExchangeLink)
    one_target: bool = False  # whether all vehicles land on one robot; each vehicle simulates the same robot
    others: tuple[Scenario, ...] = ()  # vehicles cf2, cf3 and so on

    def __post_init__(self) -> None:
        if self.target.speed_m_s > self.target.speed_max_m_s + 1e-9:
            raise ConfigError(
                f"target.speed_m_s: found {self.target.speed_m_s:g}, above target.speed_max_m_s "
                f"{self.target.speed_max_m_s:g}: raise target.speed_max_m_s, or lower target.speed_m_s"
            )
        if abs(self.target.turn_rate_rad_s) > self.target.turn_rate_max_rad_s + 1e-9:
            raise ConfigError(
                f"target.turn_rate_rad_s: found {self.target.turn_rate_rad_s:g}, above "
                f"target.turn_rate_max_rad_s {self.target.turn_rate_max_rad_s:g}"
            )
        if self.start.kind is StartKind.GROUND and self.onboard.takeoff.start_offset_m is None:
            raise ConfigError("onboard.takeoff.start_offset_m: missing; a start on the ground needs it")
        target, declared_m = self.target, self.onboard.touchdown.pad_radius_m
        if target.pad_radius_m != declared_m:
            raise ConfigError(
                f"target.pad_radius_m: found {target.pad_radius_m:g}, and onboard.touchdown.pad_radius_m: "
                f"found {declared_m:g}; there is one pad: give target.pad_radius_m alone"
            )
        self._check_members()

    def _check_members(self) -> None:
        """Check the members against each other. Raises ConfigError: names the key and the allowed value."""
        members = (self, *self.others)
        if len(members) > MEMBERS_MAX:
            raise ConfigError(f"member: found {len(members)}, allowed: 1 to {MEMBERS_MAX} tables [[member]]")
        rates = {each.onboard.loop.rate_hz for each in members}
        if len(rates) > 1:
            found = ", ".join(f"{rate:g}" for rate in sorted(rates))
            raise ConfigError(
                f"member: onboard.loop.rate_hz: found {found}; all members have the same ticks, so give the "
                "rate once, in [onboard.loop]"
            )
        for number, each in enumerate(self.others if self.one_target else (), 2):
            for key in ("target", "odometry"):
                if getattr(each, key) != getattr(self, key):
                    raise ConfigError(
                        f"member {number}: {key}: found another one than the first member's; with one_target "
                        f"all have the same robot: give it once, in [{key}]"
                    )
        if self.one_target and any(fault.of_the_robot for fault in self.fault):
            raise ConfigError("fault: found one of the robot; with one_target the robot has none")
        if self.one_target and self.target.wait_for_landing:
            raise ConfigError(
                "target.wait_for_landing: found true; with one_target the robot drives at once: set it false"
            )

    @staticmethod
    def of(members: Iterable[Scenario]) -> Scenario:
        """Return the scenario of these vehicles; the keys of the run are those of the first vehicle."""
        first, *others = members
        return replace(first, others=tuple(others))

    @property
    def members(self) -> tuple[Scenario, ...]:
        """Scenarios of all vehicles, each with only its own vehicle."""
        return (replace(self, others=()), *self.others)

    def namespaces(self, first: str = "cf1") -> dict[int, str]:
        """Return the namespaces of the vehicles by number; ``first``: namespace of the first vehicle."""
        return {1: first} | {number: member_name(number) for number, _ in enumerate(self.others, 2)}

    @property
    def rate_hz(self) -> int:
        """Number of ticks per second, equal for all members."""
        return self.onboard.loop.rate_hz

    @property
    def judged_by(self) -> Barrier:
        """Barrier of the verdict, which is evaluated with true states."""
        if self.judge is None:
            return self.onboard.barrier
        return Barrier(self.judge.alpha_1_m, self.judge.beta_m)

    def with_filter(self, name: str) -> Scenario:
        """Return this scenario with the safety filter ``name`` for all members.

        Raises ConfigError: no such filter, or the filter rejects the configuration.
        """
        return Scenario.of(replace(each, onboard=replace(each.onboard, filter=name)) for each in self.members)

    def starts_enu_m(self) -> list[Vec3]:
        """Return the start positions of members that start in the air at a given position, ENU, m."""
        found = []
        for start, target in ((each.start, each.target) for each in self.members):
            drawn = target.random_heading and target.pad_behind_axle_m
            if start.kind is StartKind.HOVER and start.offset_m is not None and not drawn:
                (x, y, z), (dx, dy, dz) = target.pad_m, start.offset_m
                found.append((x + dx, y + dy, z + dz))
        return found

    def pads_apart_m(self) -> list[float]:
        """Return the smallest possible distance of each pair of pads, m; 0 if the paths may meet."""
        lines = [each.target.line() for each in self.members]
        return [apart_m(*two) for two in combinations(lines, 2)]

    def target_seed(self, seed: int) -> int | None:
        """Return the seed of the common robot (that of the first member); None: each robot has its own."""
        return seed_of(seed, 1) if self.one_target else None

    def singles(self, seed: int) -> Iterator[tuple[Scenario, int]]:
        """Yield scenario and seed of each member. Flown alone, they fly as in the room without encounters.

        A room has one mean wind; its direction is drawn from the seed of the run if a member gives none.
        Gusts differ for each member. The first member has the seed of the run.
        """
        drawn_rad = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
        for number, each in enumerate(self.members, 1):
            wind = each.wind
            if wind.direction_rad is None:
                wind = replace(wind, direction_rad=drawn_rad)
            yield replace(each, wind=wind), seed_of(seed, number)

    def one(self, seed: int, number: int | None) -> tuple[Scenario, int]:
        """Return scenario and seed of one vehicle.

        ``seed``: seed of the run; ``number``: number of the vehicle; None: the only vehicle.
        Raises ConfigError, with found and allowed value.
        """
        members = list(self.singles(seed))
        chosen = members if number is None else members[number - 1 : number]
        if len(chosen) != 1:
            what = "one vehicle is needed" if number is None else f"found member {number}"
            raise ConfigError(f"{self.name}: {what}; the scenario has members 1 to {len(members)}")
        return chosen[0]


IN_FILES = {"others": "member"}  # keys of files, by field
_FIELDS = tuple(each.name for each in fields(Scenario))
_FILE_KEYS = (*(IN_FILES.get(name, name) for name in _FIELDS), "base")
_MEMBER_KEYS = (*(name for name in _FIELDS if name not in (*_OF_THE_RUN, *IN_FILES)), "config")


def one_pad(table: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario's table; a configuration without a pad radius gets that of the scenario's robot.

    Raises ConfigError: the robot's table is wrong; its message names the key that the user wrote.
    """
    match table:
        case {"target": {"pad_radius_m": radius_m}, "onboard": dict()}:
            from_table(TargetSpec, table["target"], "target")
            return over({"onboard": {"touchdown": {"pad_radius_m": radius_m}}}, table)
    return table


class _Files(Files[Scenario]):
    def over_base(self, path: Path, table: dict[str, Any], above: tuple[Path, ...] = ()) -> dict[str, Any]:
        """Merge as ``Files.over_base`` does; a table without ``name`` gets the name of the file."""
        own = {"name": path.stem} if "base" in table and "name" not in table else {}
        return {**super().over_base(path, table, above), **own}


_FILES = _Files(Scenario, "sim.scenarios", "scenario")
names, path_of = _FILES.names, _FILES.path_of


def load(name_or_file: str | Path) -> Scenario:
    """Load a scenario by name or path.

    Raises:
        ConfigError: with file, key, what was found and what is allowed.
    """
    path = path_of(name_or_file)
    table = read_toml(path)
    try:
        found = _built(path, table)
        for name in (name for each in found.members for name in (each.onboard.filter, each.target.function)):
            if name:
                look_here(name)
        return found
    except ConfigError as error:
        text = str(error)
        raise ConfigError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def from_text(toml: str) -> Scenario:
    """Return the scenario of a text without a base.

    Raises ConfigError, with key, found and allowed value.
    """
    return _built(Path(), parse_toml(toml.encode()))


def text(scenario: Scenario) -> str:
    """Return a scenario as the text of a complete file, without a base."""
    about = {key: to_table(getattr(scenario, key)) for key in _OF_THE_RUN}
    tables = [to_table(each) for each in scenario.members]
    shared, own = _in_common(
        [{k: v for k, v in each.items() if k not in (*about, "others")} for each in tables]
    )
    usual = {"exchange": to_table(ExchangeLink()), "one_target": False}
    kept = {key: value for key, value in about.items() if value != usual.get(key)}
    return dumps(kept | shared | ({"member": own} if own != [{}] else {}))


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


def _built(path: Path, table: dict[str, Any]) -> Scenario:
    """Build the scenario of a parsed file; ``path``: place of the file, where its base may be."""
    shared = _FILES.over_base(path, table)
    where = "member {}: " if "member" in shared else ""
    members = shared.pop("member", [{}])
    if not isinstance(members, list) or not members or not all(isinstance(each, dict) for each in members):
        raise ConfigError(f"member: found {members!r}, allowed: tables [[member]], one for each vehicle")
    if "others" in shared:
        raise ConfigError("others: unknown key; give a table [[member]] for each vehicle")
    found = []
    for number, own in enumerate(members, 1):
        for key in (*_OF_THE_RUN, "base", "others"):
            if key in own:
                raise ConfigError(
                    f"member {number}: {key}: found {own[key]!r}; only the run has it, remove it"
                )
        whole = over(_configured(path, shared, own, number), own)
        keys = _MEMBER_KEYS if own.keys() - {*_FIELDS} else _FILE_KEYS
        try:
            found.append(from_table(Scenario, one_pad(whole), keys=keys))
        except ConfigError as error:
            raise ConfigError(f"{where.format(number)}{error}") from None
    return Scenario.of(found)


def _configured(path: Path, shared: dict[str, Any], own: dict[str, Any], number: int) -> dict[str, Any]:
    """Return a member's tables: ``config`` replaces [onboard] except fleet, rate and start of landings."""
    if "config" not in own:
        return shared
    onboard = shared.get("onboard", {})
    kept = {key: onboard[key] for key in ("fleet", "loop") if key in onboard}
    if "start_offset_m" in (takeoff := onboard.get("takeoff", {})):
        kept["takeoff"] = {"start_offset_m": takeoff["start_offset_m"]}
    file = configurations.FILES.named(path, f"member {number}: config", own.pop("config"))
    return {**shared, "onboard": over(configurations.FILES.table(file), kept)}
