"""The verb ``px4-sim``: simulates the vehicle for PX4's software in the loop."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes


@dataclass(frozen=True)
class Px4SimOptions(shared.Zenoh, shared.Scenario):
    """Options of ``px4-sim``."""

    tcp: str = shared.option(
        "--tcp", default="127.0.0.1:4560", metavar="HOST:PORT",
        help="Where PX4 connects to; port 0 takes a free one.",
    )  # fmt: skip
    speed: float = shared.option(
        "--speed", type=shared.number(0.0, 100.0), default=1.0,
        help="Simulated against real time; 0: as fast as PX4 answers.",
    )  # fmt: skip
    clock: Path | None = shared.option(
        "--clock", type=shared.FILE, metavar="FILE",
        help="Write the simulated time there, for `target --clock` and `onboard --clock`, and wait for both.",
    )  # fmt: skip
    silent_max_s: float = shared.option(
        "--silent-max", type=shared.number(min=1.0), default=10.0, metavar="S",
        help="End when PX4 has not answered for S seconds.",
    )  # fmt: skip
    once: bool = shared.option(
        "--once", is_flag=True, help="End when the first PX4 disconnects, instead of waiting for the next."
    )
    form: str | None = shared.option(
        "--parameters", type=click.Choice(("env", "airframe", "console")),
        help="Print PX4's parameters for the vehicle and end: shell lines, airframe file, or for PX4's "
        "console.",
    )  # fmt: skip
    mocap: bool = shared.mocap
    duration_s: float | None = shared.duration
    namespace: str = shared.namespace
    member: int | None = shared.one_member
    recorder: Path | None = shared.recorder
    allow_unsigned: bool = shared.allow_unsigned


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
    from sim.scenarios.team import one_of

    loaded, seed = one_of(options.scenario, options.seed, options.member)
    if options.form is not None:
        poses = loaded.vehicle.mocap if options.mocap else None
        click.echo(parameter_text(params.load(loaded.vehicle.airframe), options.form, poses))
        return
    namespace = options.namespace if options.member is None else member_name(options.member)
    own = options.to(process.Px4SimOptions, seed=seed, namespace=namespace)
    sys.exit(process.px4_sim_main(loaded, own))
