"""The verb ``px4-sim``: simulates the vehicle for PX4's software in the loop."""

from __future__ import annotations

import sys
from dataclasses import replace

import click

from flightstack.cli.options import takes
from sim.options import Px4SimOptions


@click.command("px4-sim")
@takes(Px4SimOptions)
def px4_sim(options: Px4SimOptions) -> None:
    """Simulate body, rotors, wind and moving deck for PX4, which runs as the autopilot (SITL).

    PX4 connects over TCP, and both run in lockstep. Exit status: 0 normal end, 1 PX4 stopped answering,
    2 wrong input.
    """
    from logs.schema.names import member_name
    from sim.plant import params
    from sim.px4 import process
    from sim.px4.airframe import parameter_text
    from sim.scenarios.team import load

    loaded, seed = load(options.scenario).one(options.seed, options.member)
    if options.form is not None:
        poses = loaded.vehicle.mocap if options.mocap else None
        click.echo(parameter_text(params.load(loaded.vehicle.airframe), options.form, poses))
        return
    namespace = options.namespace if options.member is None else member_name(options.member)
    sys.exit(process.px4_sim_main(loaded, replace(options, seed=seed, namespace=namespace)))
