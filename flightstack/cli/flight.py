"""Commands that fly: ``sitl`` in simulation, ``fly`` a real vehicle, ``onboard`` only the onboard process."""

from __future__ import annotations

import sys

import click

from flightstack.cli.options import takes
from flightstack.common.hangup import say
from flightstack.config.options import OnboardOptions
from flightstack.launch.run_options import FlyOptions, RunOptions


@click.command()
@takes(RunOptions)
def sitl(options: RunOptions) -> None:
    """Fly a scenario in software: vehicle, target, onboard process and recorder, over MAVLink and Zenoh.

    In a scenario of several vehicles (`scenarios` lists them) each vehicle has its own onboard process.

    Exit status: 0 landed, 1 flown but not landed, 2 wrong input, or your own code failed in flight.
    """
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import conclude
    from flightstack.launch.sitl import fly_all, run

    console = Terminal(stderr=options.as_json)
    if options.runs > 1:
        sys.exit(fly_all(options, console))
    flown = run(options, console)
    sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))


@click.command()
@takes(FlyOptions)
def fly(options: FlyOptions) -> None:
    r"""Fly a real vehicle onto a real target: check it, record, show the flight, land, write a report.

    Ctrl-C, or closing the terminal, aborts: the vehicle flies clear and lands. A second Ctrl-C requests a
    landing at its position and ends the onboard process. Ctrl-\ stops the motors.

    Exit status: 0 landed, 1 not landed, 2 wrong input, or your own code failed in flight.
    """
    from flightstack.common.terminal import Terminal
    from flightstack.launch import fly as launch
    from flightstack.launch.result import conclude

    console = Terminal(stderr=options.as_json)
    flown = launch.run(options, console)
    sys.exit(conclude(flown, console, as_json=options.as_json, with_report=options.with_report))


@click.command()
@takes(OnboardOptions)
def onboard(options: OnboardOptions) -> None:
    """Run the onboard process with any vehicle and target; `fly` adds a live view and a report.

    The log is in runs/ unless --recorder or --no-record is given. Ctrl-C, or closing the terminal, aborts:
    the vehicle flies clear and lands. A second Ctrl-C requests an immediate landing and ends the process.
    """
    from flightstack.common.processes import LaunchError
    from flightstack.config.files import load
    from flightstack.onboard import process

    try:
        ended = process.run(load(options.config_file), options, say)
    except LaunchError as error:
        raise LaunchError(f"{error}; --no-record flies without a log") from error
    say(f"{ended.phase.name}: {ended.reason}")
    sys.exit(ended.exit_code)
