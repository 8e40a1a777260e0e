"""The verb ``fly``: a whole flight of a real vehicle by one command."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes

# options of the onboard process that `fly` sets itself
_OURS = ("config_file", "no_record")


@dataclass(frozen=True)
class FlyOptions(shared.Result, shared.Flight):
    """Options of ``fly``."""

    view: str | None = shared.view


@click.command()
@takes(FlyOptions)
def fly(options: FlyOptions) -> None:
    r"""Fly a real vehicle onto a real target: check it, record, show the flight, land, write a report.

    Ctrl-C, or closing the terminal, aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land
    where it is and ends the onboard process. Ctrl-\ stops the motors.

    Exit status: 0 landed, 1 not landed, 2 wrong input.
    """
    from flightstack.common.processes import LaunchError
    from flightstack.common.terminal import Terminal
    from flightstack.config.files import load
    from flightstack.launch import fly as launch
    from flightstack.launch.result import conclude
    from flightstack.onboard.fleet_wire import namespace_of

    config = load(options.config_file)
    run_options = options.to(
        launch.FlyOptions,
        name=options.config_file.stem,
        words=_words(click.get_current_context()),
        record=not options.no_record,
        live=not options.as_json,
        namespace=options.namespace or namespace_of(config),
    )
    console = Terminal(stderr=options.as_json)
    try:
        flown = launch.run(config, run_options, console)
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(error.code)
    sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))


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
