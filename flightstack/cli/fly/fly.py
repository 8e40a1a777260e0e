"""The verb ``fly``: a whole flight of a real vehicle by one command."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from flightstack.cli import options as shared
from flightstack.cli.fly.onboard import flight_options

# options of the onboard process that `fly` sets itself
_OURS = ("config_file", "no_record")


@click.command()
@flight_options
@shared.out
@shared.as_json
@shared.with_report
@shared.view
@click.pass_context
def fly(
    context: click.Context, /, config_file: Path, no_record: bool, out: Path | None, as_json: bool,
    with_report: bool, view: str | None, **plugged: Any,
) -> None:  # fmt: skip
    r"""Fly a real vehicle onto a real target: check it, record, show the flight, land, write a report.

    Ctrl-C, or closing the terminal, aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land
    where it is and ends the onboard process. Ctrl-\ stops the motors.

    Exit status: 0 landed, 1 not landed, 2 wrong input.
    """
    from rich.console import Console

    from flightstack.common.processes import LaunchError
    from flightstack.config import files as config
    from flightstack.launch.fly import FlyOptions, run
    from flightstack.launch.result import conclude

    loaded = config.load(config_file)
    options = FlyOptions(
        name=config_file.stem,
        vehicle=plugged["vehicle_url"],
        target=plugged["target_key"],
        words=_words(context),
        record=not no_record,
        out=out,
        live=not as_json,
        listen=plugged["listen"],
        namespace=plugged["namespace"],
        view=view,
    )
    console = Console(stderr=as_json, highlight=False)
    try:
        flown = run(loaded, options, console)
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(error.code)
    sys.exit(conclude(flown, console, as_json=as_json, with_report=with_report))


def _words(context: click.Context) -> list[str]:
    """Return the command line of the onboard process: its options as they were given to ``fly``."""
    from flightstack.cli.fly.onboard import onboard

    known = {option.name for option in onboard.params} - set(_OURS)
    found: list[str] = []
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if option.name not in known or not isinstance(option, click.Option) or value is None:
            continue
        if option.is_flag:
            found += [option.opts[0]] if value else []
            continue
        for each in value if option.multiple else (value,):
            texts = each if option.nargs > 1 else (each,)
            found += [option.opts[0], *map(str, texts)]
    return found
