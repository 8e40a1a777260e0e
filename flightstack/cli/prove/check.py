"""The verb ``check``: proves a configuration before flight."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from flightstack.cli.options import takes
from flightstack.common.options import Argument
from flightstack.common.strict_toml import ConfigError, from_table, read_toml
from flightstack.config import options as shared
from flightstack.config.files import load, names, path_of
from flightstack.core.parameters.flight import FlightConfig
from logs.schema.names import member_name

if TYPE_CHECKING:
    from flightstack.verify.types import Check
    from sim.scenarios.scenario import Scenario
    from sim.scenarios.team import TeamScenario

PROVEN, NOT_PROVEN = 0, 1


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Options of ``check``."""

    config: Annotated[str, Argument(metavar="CONFIG")]
    filter: Annotated[
        str | None, shared.safety_filter("Check it for this safety filter; default: the configuration's")
    ] = None
    as_json: shared.AsJson = False


@click.command()
@takes(CheckOptions)
def check(options: CheckOptions) -> None:
    """Prove before flight that the filter's guarantees hold for everything that CONFIG declares.

    CONFIG is a configuration of `onboard` or a scenario, by name or as a file; of a scenario of several
    vehicles each member is checked, and all of them together. Each line shows a claim, its worst point, and
    the distance to its limit there (docs/how_it_works/robust_filter.md, docs/how_it_works/fleet.md). Of a
    scenario also what its configuration declares of barrier, robot, pad and links is compared with the rest.

    Exit status: 0 all claims proven, 1 at least one not proven, 2 wrong input.
    """
    from flightstack.verify.certificate import checks

    parts = []
    for part in _load(options.config):
        configs = part.configs
        if options.filter is not None:
            configs = [replace(config, filter=options.filter) for config in configs]
        name = f"{options.config}{part.of}, filter {configs[0].filter}"
        results = part.together(configs) if part.together else checks(configs[0])
        results = [*results, *part.declares(configs[0])]
        parts.append((name, part.members, configs[0].filter, results))
    if options.as_json:
        click.echo(json.dumps(_as_json(options.config, parts)))
    else:
        for name, _, _, results in parts:
            _show(name, results)
    sys.exit(PROVEN if all(each.proven for *_, results in parts for each in results) else NOT_PROVEN)


@dataclass(frozen=True)
class Part:
    """What is checked at once.

    Attributes:
        configs: one, or those of all members.
        members: names of the vehicles that have it; none: it is no team's.
        together: makes the checks of all members; None: those of one configuration.
        scenario: that the configuration is one of, alone.
    """

    configs: list[FlightConfig]
    members: tuple[str, ...] = ()
    together: Callable[[list[FlightConfig]], list[Check]] | None = None
    scenario: Scenario | None = None

    def declares(self, config: FlightConfig) -> list[Check]:
        """Checks of the configuration against its scenario."""
        if self.scenario is None:
            return []
        from sim.vehicle.declared import declared

        return declared(replace(self.scenario, onboard=config))

    @property
    def of(self) -> str:
        """Which vehicles, for a title."""
        return f" ({', '.join(self.members)}{' together' if self.together else ''})" if self.members else ""


def _load(name_or_file: str) -> list[Part]:
    """Load a configuration, or those of a scenario, by name or file."""
    path = path_of(name_or_file) if name_or_file in names() else Path(name_or_file)
    if path.is_file():
        table = read_toml(path)
        scenario_below = "base" in table and table["base"] not in names()
        if "onboard" not in table and "member" not in table and not scenario_below:
            return [Part([load(path)])]
        if not scenario_below and "member" not in table and "name" not in table:
            try:
                return [Part([from_table(FlightConfig, table["onboard"], "onboard")])]
            except ConfigError as error:
                raise ConfigError(f"{path}: {error}") from None
    from sim.scenarios.team import load as load_scenario

    found = load_scenario(path if path.is_file() else name_or_file)
    if found.is_alone:
        return [Part([found.member[0].onboard], scenario=found.member[0])]
    return of_team(found)


def of_team(team: TeamScenario) -> list[Part]:
    """Members whose configurations differ in the id alone at once, then all together."""
    from flightstack.verify.team import team_checks
    from sim.plant.params import load as load_params
    from sim.vehicle.encounters import Shape

    configs = [each.onboard for each in team.member]
    alike: list[tuple[FlightConfig, list[int]]] = []
    for number, config in enumerate(configs):
        fleet = None if config.fleet is None else replace(config.fleet, id=min(config.fleet.members))
        same = replace(config, fleet=fleet)
        for other, numbers in alike:
            if other == same:
                numbers.append(number)
                break
        else:
            alike.append((same, [number]))
    parts = [
        Part([configs[numbers[0]]], tuple(member_name(number + 1) for number in numbers))
        for _, numbers in alike
    ]
    if all(config.fleet is not None for config in configs):
        shapes = [Shape.of(load_params(each.vehicle.airframe)) for each in team.member]
        radius_m = 2.0 * max(shape.radius_m for shape in shapes)
        up_m = max(shape.top_m for shape in shapes) - min(shape.bottom_m for shape in shapes)
        starts, apart_m = team.starts_enu_m(), team.pads_apart_m()
        parts.append(
            Part(
                configs,
                tuple(member_name(number + 1) for number in range(len(configs))),
                lambda found: team_checks(found, starts, (radius_m, 0.0, up_m), apart_m),
            )
        )
    return parts


def _as_json(name: str, parts: list[tuple[str, tuple[str, ...], str, list[Check]]]) -> dict[str, object]:
    every = [result for *_, results in parts for result in results]
    found: dict[str, object] = {
        "config": name,
        "filter": parts[0][2],
        "proven": all(result.proven for result in every),
        "flies": all(result.proven for result in every if result.need.value == "flight"),
    }
    lists = [[_row(result) for result in results] for *_, results in parts]
    if not parts[0][1]:
        return {**found, "checks": lists[0]}
    return {
        **found,
        "parts": [{"members": part[1], "checks": each} for part, each in zip(parts, lists, strict=True)],
    }


def _row(result: Check) -> dict[str, object]:
    return {
        "name": result.name,
        "claim": result.claim,
        "proven": result.proven,
        "need": result.need.value,
        "room": result.room if math.isfinite(result.room) else None,
        "unit": result.unit,
        "worst": result.worst,
        "remedy": None if result.proven else result.remedy,
    }


def _show(name: str, results: list[Check]) -> None:
    from rich.table import Column, Table
    from rich.text import Text

    from flightstack.common.terminal import Terminal

    columns = [Column(heading, overflow="fold") for heading in ("", "claim", "room", "worst point")]
    columns[2].justify = "right"
    table = Table(*columns, title=name, title_justify="left")
    for result in results:
        word, colour = _WORDS[result.proven, result.need.value]
        room = "no bound" if math.isinf(result.room) else f"{result.room:.3g} {result.unit}".strip()
        claim = f"{result.name}: {result.claim}"
        table.add_row(Text(word, style=colour), Text(claim), Text(room), Text(result.worst))
    console = Terminal()
    console.print(table)
    for result in results:
        if not result.proven:
            console.print(Text(f"{result.name}: {result.remedy}"), soft_wrap=True)


_WORDS = {
    (True, "flight"): ("proven", "green"),
    (True, "proof"): ("proven", "green"),
    (False, "flight"): ("must not fly", "red"),
    (False, "proof"): ("not proven", "yellow"),
}
