"""The verb ``px4-sim``: simulates the vehicle for PX4's software in the loop."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import plugs


@click.command("px4-sim")
@shared.scenario()
@shared.seed
@click.option(
    "--tcp", default="127.0.0.1:4560", show_default=True, metavar="HOST:PORT",
    help="Where PX4 connects to; port 0 takes a free one.",
)  # fmt: skip
@click.option(
    "--speed", type=click.FloatRange(0.0, 100.0), default=1.0, show_default=True,
    help="Simulated against real time; 0: as fast as PX4 answers.",
)  # fmt: skip
@click.option(
    "--clock", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Write the simulated time there, for `target --clock` and `onboard --clock`, and wait for both.",
)  # fmt: skip
@click.option(
    "--silent-max", "silent_max_s", type=click.FloatRange(min=1.0), default=10.0, show_default=True,
    metavar="S", help="End when PX4 has not answered for S seconds.",
)  # fmt: skip
@click.option(
    "--once", is_flag=True, help="End when the first PX4 disconnects, instead of waiting for the next."
)
@click.option(
    "--parameters", "form", type=click.Choice(("env", "airframe", "console")),
    help="Print PX4's parameters for the vehicle and end: shell lines, airframe file, or for PX4's console.",
)  # fmt: skip
@click.option("--mocap", is_flag=True, help="Give PX4 the scenario's motion capture instead of satellites.")
@plugs
@shared.namespace
@shared.recorder
@shared.duration
@shared.allow_unsigned
def px4_sim(
    scenario: str, seed: int, tcp: str, speed: float, clock: Path | None, silent_max_s: float, once: bool,
    form: str | None, mocap: bool, connect: tuple[str, ...], listen: tuple[str, ...],
    zenoh_config: Path | None, namespace: str, recorder: Path | None, duration_s: float | None,
    allow_unsigned: bool,
) -> None:  # fmt: skip
    """Simulate body, rotors, wind and moving deck for PX4, which runs as the autopilot (SITL).

    PX4 connects over TCP, and both run in lockstep. Exit status: 0 normal end, 1 PX4 stopped answering,
    2 wrong input.
    """
    from sim.plant import params
    from sim.px4.airframe import parameter_text
    from sim.px4.process import px4_sim_main
    from sim.scenarios.scenario import load

    loaded = load(scenario)
    if form is not None:
        poses = loaded.vehicle.mocap if mocap else None
        click.echo(parameter_text(params.load(loaded.vehicle.airframe), form, poses))
        return
    sys.exit(
        px4_sim_main(
            loaded, seed, tcp, speed=speed, clock=clock, silent_max_s=silent_max_s, once=once, mocap=mocap,
            duration_s=duration_s, feed_socket=str(recorder) if recorder else None,
            zenoh_connect=list(connect), zenoh_listen=list(listen), zenoh_config=zenoh_config,
            namespace=namespace, allow_unsigned=allow_unsigned,
        )
    )  # fmt: skip
