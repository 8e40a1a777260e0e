"""Command ``identify``: measurement of the robust filter's assumptions in flight logs."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import click

from flightstack.cli.options import takes, without_recordings
from flightstack.common.options import Argument, Option
from flightstack.common.terminal import Terminal
from sim.campaign.progress import Bar


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of ``identify``."""

    logs: Annotated[tuple[Path, ...], Argument(metavar="[LOG...]", exists=True)] = ()
    flights: Annotated[Path | None, Option(
        "--flights", "Fit a vehicle's file to the recorded flights in DIR (Parquet, CSV) instead.", "DIR",
        exists=True, path="folder"
    )] = None  # fmt: skip
    vehicle: Annotated[
        str, Option("--vehicle", "With --flights: the file that the fit starts from.", metavar="NAME_OR_FILE")
    ] = "crazyflie21_room"
    columns: Annotated[Path | None, Option(
        "--columns",
        "With --flights: TOML with the recordings' columns, units and signs; default: NanoBench's.", "FILE",
        path="file", exists=True
    )] = None  # fmt: skip
    out: Annotated[Path | None, Option(
        "--out", "With --flights: write the vehicle's file there.", "FILE", path="file"
    )] = None  # fmt: skip
    as_json: Annotated[bool, Option("--json", "Print one JSON object instead of TOML.")] = False


@click.command()
@takes(IdentifyOptions)
def identify(options: IdentifyOptions) -> None:
    """Find a vehicle's response to velocity set-points, and the noise of its measurements, in flight LOGs.

    The command prints the sections of a configuration; several flights, of several vehicles, give their
    spread. With --flights, it fits thrust, motor lag, drag, inertia and battery to recorded flights and
    prints a vehicle file.

    Exit status: 0 found, 2 wrong input or flights without enough excitation; the text says what to fly.
    """
    if options.flights is not None:
        if options.logs:
            raise click.UsageError(f"found --flights and {len(options.logs)} LOG; give one of them")
        _identify_vehicle(options, options.flights)
        return
    if not options.logs:
        raise click.UsageError("found neither LOG nor --flights; give logs of flights, or --flights DIR")
    from logs.reader.flight import load_fleet
    from logs.tools import identified

    flights = [flight for path in options.logs for flight in load_fleet(path).flights.values()]
    found = identified.gather(flights)
    if options.as_json:
        click.echo(json.dumps(found.as_json()))
    else:
        click.echo(identified.toml(found, len(flights)), nl=False)


def _identify_vehicle(options: IdentifyOptions, folder: Path) -> None:
    """Fit a vehicle file to recorded flights."""
    try:
        from sim.flights.recording import COLUMNS, find_recordings, read_columns
        from sim.plant.params import load
        from sim.validation import identified
        from sim.validation.fit import together
    except ModuleNotFoundError as error:
        raise without_recordings(error, "identify --flights") from None

    columns, params = read_columns(options.columns or COLUMNS), load(options.vehicle)
    console = Terminal(stderr=True)
    with Bar(console, "flights", len(find_recordings(folder))) as bar:
        fits, left_out = identified.gather(folder, columns, params, bar.done)
    for name, reason in left_out.items():
        console.print(f"left out {name}: {reason}", soft_wrap=True)
    fit = together(fits)
    text = identified.toml(fit, params, options.vehicle)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")
    if options.as_json:
        values = {
            "flights": len(fits) + len(left_out),
            "used": len(fits),
            "left_out": left_out,
            "numbers": {name: asdict(number) for name, number in fit.numbers.items()},
        }
        click.echo(json.dumps(values))
    else:
        click.echo(text, nl=False)
