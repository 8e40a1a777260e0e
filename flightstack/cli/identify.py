"""Command ``identify``: measurement of the robust filter's assumptions in flight logs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click

from flightstack.cli.options import takes
from flightstack.common.options import Argument, Option


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of ``identify``."""

    logs: Annotated[tuple[Path, ...], Argument(metavar="LOG...", exists=True)]
    as_json: Annotated[bool, Option("--json", "Print one JSON object instead of TOML.")] = False


@click.command()
@takes(IdentifyOptions)
def identify(options: IdentifyOptions) -> None:
    """Find a vehicle's response to velocity set-points, and the noise of its measurements, in flight LOGs.

    The command prints the sections of a configuration; several flights, of several vehicles, give their
    spread.

    Exit status: 0 found, 2 wrong input or flights without enough excitation; the text says what to fly.
    """
    from logs.reader.flight import load_fleet
    from logs.tools import identified

    flights = [flight for path in options.logs for flight in load_fleet(path).flights.values()]
    found = identified.gather(flights)
    if options.as_json:
        click.echo(json.dumps(found.as_json()))
    else:
        click.echo(identified.toml(found, len(flights)), nl=False)
