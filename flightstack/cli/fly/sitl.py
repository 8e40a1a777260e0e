"""The verb ``sitl``: a whole flight in software, by one command."""

from __future__ import annotations

import sys

import click

from flightstack.cli.options import takes
from flightstack.launch.run_options import RunOptions


@click.command()
@takes(RunOptions)
def sitl(options: RunOptions) -> None:
    """Fly a scenario in software: vehicle, target, onboard process and recorder, over the real wires.

    A scenario of several vehicles (`scenarios` lists them) flies all of them, with an onboard process each.

    Exit status: 0 landed, 1 flown but not landed, 2 wrong input.
    """
    options.check()
    from flightstack.common.processes import LaunchError
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import conclude
    from flightstack.launch.runs import fly_all
    from flightstack.launch.sitl import run

    console = Terminal(stderr=options.as_json)
    try:
        if options.runs > 1:
            sys.exit(fly_all(options, console))
        flown = run(options, console)
        sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(error.code)
