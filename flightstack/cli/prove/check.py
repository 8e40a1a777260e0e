"""The verb ``check``: proves a configuration before flight."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes
from flightstack.common.strict_toml import ConfigError, from_table, read_toml
from flightstack.config.files import load, names, path_of
from flightstack.core.parameters.flight import FlightConfig

if TYPE_CHECKING:
    from flightstack.verify.types import Check

PROVEN, NOT_PROVEN = 0, 1


@dataclass(frozen=True)
class CheckOptions(shared.Options):
    """Options of ``check``."""

    config: str = shared.argument(metavar="CONFIG")
    filter: str | None = shared.safety_filter("Check it for this safety filter; default: the configuration's")
    as_json: bool = shared.json()


@click.command()
@takes(CheckOptions)
def check(options: CheckOptions) -> None:
    """Prove before flight that the filter's guarantees hold for everything that CONFIG declares.

    CONFIG is a configuration of `onboard` or a scenario, by name or as a file. Each line shows a claim, its
    worst point, and the distance to its limit there (docs/how_it_works/robust_filter.md).

    Exit status: 0 all claims proven, 1 at least one not proven, 2 wrong input.
    """
    from flightstack.verify.certificate import checks

    found = _load(options.config)
    if options.filter is not None:
        found = replace(found, filter=options.filter)
    results = checks(found)
    if options.as_json:
        click.echo(json.dumps(_as_json(options.config, found, results)))
    else:
        _show(options.config, found, results)
    sys.exit(PROVEN if all(result.proven for result in results) else NOT_PROVEN)


def _load(name_or_file: str) -> FlightConfig:
    """Load a configuration, or that of a scenario, by name or file."""
    path = path_of(name_or_file) if name_or_file in names() else Path(name_or_file)
    if path.is_file():
        table = read_toml(path)
        scenario_below = "base" in table and table["base"] not in names()
        if "onboard" not in table and not scenario_below:
            return load(path)
        if scenario_below:
            from sim.scenarios.scenario import load as load_scenario

            return load_scenario(path).onboard
        try:
            return from_table(FlightConfig, table["onboard"], "onboard")
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    from sim.scenarios.scenario import load as load_scenario

    return load_scenario(name_or_file).onboard


def _as_json(name: str, config: FlightConfig, results: list[Check]) -> dict[str, object]:
    return {
        "config": name,
        "filter": config.filter,
        "proven": all(result.proven for result in results),
        "flies": all(result.proven for result in results if result.need.value == "flight"),
        "checks": [
            {
                "name": result.name,
                "claim": result.claim,
                "proven": result.proven,
                "need": result.need.value,
                "room": result.room if math.isfinite(result.room) else None,
                "unit": result.unit,
                "worst": result.worst,
                "remedy": None if result.proven else result.remedy,
            }
            for result in results
        ],
    }


def _show(name: str, config: FlightConfig, results: list[Check]) -> None:
    from rich.console import Console
    from rich.table import Column, Table
    from rich.text import Text

    columns = [Column(heading, overflow="fold") for heading in ("", "claim", "room", "worst point")]
    columns[2].justify = "right"
    table = Table(*columns, title=f"{name}, filter {config.filter}", title_justify="left")
    for result in results:
        word, colour = _WORDS[result.proven, result.need.value]
        room = "no bound" if math.isinf(result.room) else f"{result.room:.3g} {result.unit}".strip()
        claim = f"{result.name}: {result.claim}"
        table.add_row(Text(word, style=colour), Text(claim), Text(room), Text(result.worst))
    console = Console()
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
