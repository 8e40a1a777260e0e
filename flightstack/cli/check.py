"""Command ``check``: proof of a configuration before a flight."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Sequence
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
    if as_json:
        click.echo(json.dumps(_as_json(config, parts)))
    else:
        console = Terminal()
        for part in parts:
            console.print(f"{config}{part.of}, filter {part.filter}", soft_wrap=True)
            for result in part.checks:
                if every or not result.proven:
                    _show(console, result)
            for text in part.ignored:
                click.echo(text)
        click.echo(_summary(parts) + ("" if every else "; --all shows each claim"))
    sys.exit(PROVEN if all(each.proven for part in parts for each in part.checks) else NOT_PROVEN)


def _summary(parts: Sequence[Part]) -> str:
    """Return the last line of the output: all claims are proven, or the names of the unproven ones."""
    every = [(part.of, result) for part in parts for result in part.checks]
    found = [f"{result.name}{of}" for of, result in every if not result.proven]
    if not found:
        return f"proven: all {len(every)} claims"
    flies = all(result.proven for _, result in every if result.need.value == "flight")
    verdict = "not proven" if flies else "not proven, must not fly"
    return f"{verdict}: {len(found)} of {len(every)} claims: {'; '.join(found)}"


class Part(NamedTuple):
    """Part of a check: one configuration, or all vehicles together."""

    filter: str
    checks: Sequence[Check]
    members: tuple[str, ...] = ()  # names of the scenario's vehicles with this configuration
    of: str = ""  # names of the vehicles, for a title
    ignored: Sequence[str] = ()  # keys that the filter does not read


def _parts(name_or_file: str, name: str | None) -> list[Part]:
    """Check a configuration, or those of a scenario, with this filter; None: with the configured one."""
    from flightstack.verify.certificate import checks

    config = _configuration(name_or_file)
    if config is not None:
        config = replace(config, filter=name or config.filter)
        return [Part(config.filter, checks(config), ignored=ignored(config))]
    from sim.robot import TargetModel
    from sim.scenarios.scenario import load as load_scenario
    from sim.scenarios.tables import PathKind
    from sim.vehicle.declared import crowd, declared

    scenario = load_scenario(name_or_file)
    for each in (each for each in scenario.members if each.target.path is PathKind.FUNCTION):
        TargetModel(each.target, 0).run(round(each.duration_max_s / STEP_S), STEP_S, True)
    if name is not None:
        scenario = scenario.with_filter(name)
    shown, parts = list(scenario.namespaces().values()), []
    for config, numbers in _alike([each.onboard for each in scenario.members]):
        found = [*checks(config), *_worst(check for n in numbers for check in declared(scenario.members[n]))]
        parts.append(_part(config, found, [shown[n] for n in numbers]))
    if found := crowd(scenario):
        parts.append(_part(scenario.onboard, found, shown, " together"))
    return parts if len(parts) > 1 else [parts[0]._replace(of="")]


def _part(config: FlightConfig, found: list[Check], members: list[str], more: str = "") -> Part:
    of = f" ({', '.join(members)}{more})"
    return Part(config.filter, found, tuple(members), of, () if more else ignored(config))


def _worst(found: Iterable[Check]) -> list[Check]:
    """Return each check once: of results with one name, the one with the smallest distance to its limit."""
    worst: dict[str, Check] = {}
    for each in found:
        if each.name not in worst or each.room < worst[each.name].room:
            worst[each.name] = each
    return list(worst.values())


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


def _alike(configs: Sequence[FlightConfig]) -> list[tuple[FlightConfig, list[int]]]:
    """Return configurations that differ in more than the id, each with the indices of its vehicles."""
    alike: dict[str, tuple[FlightConfig, list[int]]] = {}
    for n, config in enumerate(configs):
        table = to_table(config)
        table.get("fleet", {}).pop("id", None)
        alike.setdefault(repr(table), (config, []))[1].append(n)
    return list(alike.values())


def _as_json(name: str, parts: Sequence[Part]) -> dict[str, object]:
    every = [result for part in parts for result in part.checks]
    found: dict[str, object] = {
        "config": name,
        "filter": parts[0].filter,
        "proven": all(result.proven for result in every),
        "ignored": [text for part in parts for text in part.ignored],
        "flies": all(result.proven for result in every if result.need.value == "flight"),
    }
    rows: list[dict[str, object]] = [
        {
            **({"members": part.members} if part.members else {}),
            "checks": [_row(result) for result in part.checks],
        }
        for part in parts
    ]
    return {**found, **(rows[0] if len(rows) == 1 else {"parts": rows})}


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
    word, colour = _WORDS[result.proven, result.need.value]
    console.print(Text.assemble((word, colour), f": {result.name}: {result.claim}"), soft_wrap=True)
    room = f"{abs(result.room):.3g} {result.unit}".rstrip()
    distance = f"; {'distance to limit' if result.proven else 'short by'} {room}"
    worst = f"{result.worst}{distance if math.isfinite(result.room) else ''}"
    console.print(f"  worst point: {worst}", soft_wrap=True)
    if not result.proven:
        console.print(f"  remedy: {result.remedy}", soft_wrap=True)


_WORDS = {
    (True, "flight"): ("proven", "green"),
    (True, "proof"): ("proven", "green"),
    (False, "flight"): ("must not fly", "red"),
    (False, "proof"): ("not proven", "yellow"),
}
