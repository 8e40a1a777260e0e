"""The verbs of the simulator: ``vehicle``, ``target`` and ``scenarios``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import plugs, ros2, ros2_network


@click.command()
@shared.scenario()
@shared.seed
@click.option(
    "--url",
    default="udpin:127.0.0.1:14580",
    show_default=True,
    help="MAVLink URL to serve; port 0 takes a free one.",
)
@plugs
@shared.namespace
@shared.recorder
@shared.rate
@shared.lockstep
@shared.duration
@click.option(
    "--peer",
    "peers",
    multiple=True,
    metavar="HOST:PORT",
    help="Send telemetry there without being asked, e.g. 127.0.0.1:14540 for MAVSDK; repeatable.",
)
@shared.personality
@shared.parameters
@shared.signing_key
@shared.allow_unsigned
def vehicle(
    scenario: str, seed: int, url: str, connect: tuple[str, ...], listen: tuple[str, ...], namespace: str,
    recorder: Path | None, rate_hz: int, lockstep: bool, duration_s: float | None, peers: tuple[str, ...],
    signing_key: Path | None, allow_unsigned: bool, zenoh_config: Path | None, personality: str,
    parameters: dict[str, float],
) -> None:  # fmt: skip
    """Run the simulated Crazyflie as a MAVLink vehicle; its deck follows the target's true pose on Zenoh."""
    from sim.runners.vehicle_process import vehicle_main
    from sim.scenarios.scenario import load

    sys.exit(
        vehicle_main(
            load(scenario), seed, url, lockstep=lockstep, rate_hz=rate_hz,
            feed_socket=str(recorder) if recorder else None, zenoh_connect=list(connect),
            zenoh_listen=list(listen), namespace=namespace, duration_s=duration_s, peers=list(peers),
            signing_key=signing_key, allow_unsigned=allow_unsigned, zenoh_config=zenoh_config,
            personality=personality, parameters=parameters,
        )
    )  # fmt: skip


@click.command()
@shared.scenario()
@shared.seed
@plugs
@ros2
@shared.namespace
@shared.recorder
@shared.rate
@shared.lockstep
@shared.speed
@shared.clock
@shared.duration
def target(
    scenario: str, seed: int, connect: tuple[str, ...], listen: tuple[str, ...], namespace: str,
    recorder: Path | None, rate_hz: int, lockstep: bool, duration_s: float | None, zenoh_config: Path | None,
    ros2_where: str | None, ros_domain: int, speed: float, clock: Path | None,
) -> None:  # fmt: skip
    """Run the simulated ground robot: it drives the scenario's path and publishes its odometry on Zenoh."""
    from sim.compiled.jit import OFF

    # The robot needs only a hundred short steps a second: loading numba would take longer than it saves.
    os.environ.setdefault(OFF, "1")
    from sim.runners.target_process import target_main
    from sim.scenarios.scenario import load

    sys.exit(
        target_main(
            load(scenario), seed, lockstep=lockstep, rate_hz=rate_hz, listen=list(listen),
            connect=list(connect), namespace=namespace, duration_s=duration_s,
            feed_socket=str(recorder) if recorder else None, zenoh_config=zenoh_config,
            ros2=ros2_network(ros2_where, ros_domain), speed=speed, clock=clock,
        )
    )  # fmt: skip


@click.command()
@click.argument("name", required=False)
def scenarios(name: str | None) -> None:
    """List the scenarios that come with the simulator, or print the one NAMEd."""
    from sim.scenarios import scenario

    if name is not None:
        click.echo(scenario.path_of(name).read_text(), nl=False)
        return
    for known in scenario.names():
        click.echo(f"{known:18} {scenario.load(known).description}")
