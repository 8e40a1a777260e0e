"""The verb ``fly``: a whole flight of a real vehicle by one command."""

from __future__ import annotations

import sys

import click

from flightstack.cli.options import takes
from flightstack.launch.run_options import FlyOptions


@click.command()
@takes(FlyOptions)
def fly(options: FlyOptions) -> None:
    r"""Fly a real vehicle onto a real target: check it, record, show the flight, land, write a report.

    Ctrl-C, or closing the terminal, aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land
    where it is and ends the onboard process. Ctrl-\ stops the motors.

    Exit status: 0 landed, 1 not landed, 2 wrong input.
    """
    from flightstack.common.terminal import Terminal
    from flightstack.launch import fly as launch
    from flightstack.launch.result import conclude

    console = Terminal(stderr=options.as_json)
    flown = launch.run(options, console)
    sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))
