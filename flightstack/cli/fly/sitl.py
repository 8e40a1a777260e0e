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
    from flightstack.launch import fleet
    from flightstack.launch.fleet_result import conclude_fleet, fly_fleet
    from flightstack.launch.result import conclude
    from flightstack.launch.sitl import fly_all, fly_one, run
    from sim.scenarios.team import load

    result = {"as_json": options.as_json, "with_report": options.with_report}
    console, team = Terminal(stderr=options.as_json), not load(options.scenario).is_alone
    try:
        if options.runs > 1:
            sys.exit(fly_all(options, options.runs, console, fly_fleet if team else fly_one, **result))
        if team:
            sys.exit(conclude_fleet(fleet.run(options, console), console, **result))
        sys.exit(conclude(run(options, console), console, **result))
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(error.code)
