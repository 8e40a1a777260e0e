"""Command ``check``: proof of a configuration before a flight."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import click
from rich.text import Text

from flightstack.common.options import Option, arguments
from flightstack.common.strict_toml import ConfigError, from_table, read_toml, to_table
from flightstack.common.terminal import Terminal
from flightstack.config import load, names, path_of
from flightstack.config import options as shared
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import ignored

if TYPE_CHECKING:
    from flightstack.verify.types import Check

PROVEN, NOT_PROVEN = 0, 1
STEP_S = 0.01  # time between two calls of the robot's function, s


@click.command()
@arguments
def check(
    config: Annotated[str, Option("CONFIG")],
    filter: Annotated[
        str | None, shared.safety_filter("Check it for this safety filter; default: the configuration's")
    ] = None,
    every: Annotated[
        bool, Option("--all", "Show each claim with its worst point, also those that are proven")
    ] = False,
    as_json: shared.AsJson = False,
) -> None:
    """Prove before a flight that the filter's guarantees hold in the whole range that CONFIG declares.

    CONFIG is the name or file of an `onboard` configuration or of a scenario; a scenario of several vehicles
    is checked for each member, and for all of them together. The output contains each claim that is not
    proven, with what was found and what to change; --all also shows the proven ones, with the distance to
    their limit (docs/how_it_works/robust_filter.md, docs/how_it_works/fleet.md). For a scenario, the
    configuration's barrier, robot, pad and links are also compared with the simulated ones.

    Exit status: 0 all claims proven, 1 at least one not proven, 2 wrong input.
    """
    parts = _parts(config, filter)
    results = [(part, result) for part in parts for result in part.checks]
    unproven = [f"{result.name}{part.of}" for part, result in results if not result.proven]
    flies = all(result.proven for _, result in results if result.need.value == "flight")
    if as_json:
        rows = [{**part.members, "checks": list(map(_row, part.checks))} for part in parts]
        about = {
            "config": config,
            "filter": parts[0].filter,
            "proven": not unproven,
            "ignored": [text for part in parts for text in part.ignored],
            "flies": flies,
        }
        click.echo(json.dumps({**about, **(rows[0] if len(rows) == 1 else {"parts": rows})}))
        sys.exit(NOT_PROVEN if unproven else PROVEN)
    console = Terminal()
    for part in parts:
        console.print(f"{config}{part.of}, filter {part.filter}", soft_wrap=True)
        for result in part.checks:
            if every or not result.proven:
                _show(console, result)
        for text in part.ignored:
            click.echo(text)
    verdict = f"proven: all {len(results)} claims"
    if unproven:
        must_not = "" if flies else ", must not fly"
        verdict = f"not proven{must_not}: {len(unproven)} of {len(results)} claims: {'; '.join(unproven)}"
    click.echo(verdict + ("" if every else "; --all shows each claim"))
    sys.exit(NOT_PROVEN if unproven else PROVEN)


class Part(NamedTuple):
    """Part of a check: one configuration, or all vehicles of a scenario together."""

    filter: str
    checks: Sequence[Check]
    members: Mapping[str, Sequence[str]]  # names of the vehicles for the JSON object; empty: one vehicle
    of: str  # names of the vehicles, for a title
    ignored: Sequence[str]  # keys that the filter does not read


def _parts(name_or_file: str, name: str | None) -> list[Part]:
    """Check the configuration or the scenario with the filter ``name``; None: the configured filter."""
    from flightstack.verify.certificate import checks
    from flightstack.verify.types import worst

    config = _configuration(name_or_file)
    if config is not None:
        config = replace(config, filter=name or config.filter)
        return [Part(config.filter, checks(config), {}, "", ignored(config))]
    from sim.robot import TargetModel
    from sim.scenarios.scenario import load as load_scenario
    from sim.scenarios.tables import PathKind
    from sim.vehicle.declared import crowd, declared

    scenario = load_scenario(name_or_file)
    for each in (each for each in scenario.members if each.target.path is PathKind.FUNCTION):
        TargetModel(each.target, 0).run(round(each.duration_max_s / STEP_S), STEP_S, True)
    if name is not None:
        scenario = scenario.with_filter(name)
    shown, parts = list(scenario.namespaces().values()), list[Part]()

    def add(config: FlightConfig, found: list[Check], members: list[str], more: str = "") -> None:
        of, keys = f" ({', '.join(members)}{more})", () if more else ignored(config)
        parts.append(Part(config.filter, found, {"members": members}, of, keys))

    # vehicles whose configurations differ only in the vehicle id form one part
    alike: dict[str, list[int]] = {}
    for n, each in enumerate(scenario.members):
        table = to_table(each.onboard)
        table.get("fleet", {}).pop("id", None)
        alike.setdefault(repr(table), []).append(n)
    for numbers in alike.values():
        config = scenario.members[numbers[0]].onboard
        found = worst(each for n in numbers for each in declared(scenario.members[n]))
        add(config, [*checks(config), *found], [shown[n] for n in numbers])
    if found := crowd(scenario):
        add(scenario.onboard, found, shown, " together")
    return parts if len(parts) > 1 else [parts[0]._replace(of="")]


def _configuration(name_or_file: str) -> FlightConfig | None:
    """Return the configuration of this name or file; None: the name or file is that of a scenario."""
    path = path_of(name_or_file) if name_or_file in names() else Path(name_or_file)
    if not path.is_file():
        return None
    table = read_toml(path)
    if ("base" in table and table["base"] not in names()) or "member" in table:
        return None
    if "onboard" not in table:
        return load(path)
    if "name" in table:
        return None
    try:
        return from_table(FlightConfig, table["onboard"], "onboard")
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _row(result: Check) -> dict[str, object]:
    return {
        **asdict(result),
        "proven": result.proven,
        "need": result.need.value,
        "room": result.room if math.isfinite(result.room) else None,
        "remedy": None if result.proven else result.remedy,
    }


def _show(console: Terminal, result: Check) -> None:
    """Print a claim with its worst point, and the remedy if it is not proven."""
    word, colour = ("must not fly", "red") if result.need.value == "flight" else ("not proven", "yellow")
    if result.proven:
        word, colour = "proven", "green"
    console.print(Text.assemble((word, colour), f": {result.name}: {result.claim}"), soft_wrap=True)
    room = f"{abs(result.room):.3g} {result.unit}".rstrip()
    distance = f"; {'distance to limit' if result.proven else 'short by'} {room}"
    worst = f"{result.worst}{distance if math.isfinite(result.room) else ''}"
    console.print(f"  worst point: {worst}", soft_wrap=True)
    if not result.proven:
        console.print(f"  remedy: {result.remedy}", soft_wrap=True)
