"""The verb ``sitl``: a whole flight in software, by one command."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from flightstack import cli_options as shared
from flightstack.cli_zenoh import ros2, ros2_network, zenoh_config
from flightstack.config import FilterKind


@click.command()
@shared.scenario()
@shared.seed
@click.option(
    "--filter",
    "filter_name",
    type=click.Choice([k.value for k in FilterKind]),
    help="Safety filter; default: the scenario's.",
)
@shared.lockstep
@shared.duration
@shared.out
@shared.as_json
@shared.with_report
@shared.signing_key
@ros2
@zenoh_config
@shared.personality
@shared.autopilot
@click.option(
    "--listen", multiple=True, metavar="ENDPOINT",
    help="Zenoh endpoint where others may watch, besides the one of loopback that is printed; repeatable.",
)  # fmt: skip
def sitl(
    scenario: str, seed: int, filter_name: str | None, lockstep: bool, duration_s: float | None,
    out: Path | None, as_json: bool, with_report: bool, signing_key: Path | None, listen: tuple[str, ...],
    ros2_where: str | None, ros_domain: int, zenoh_config: Path | None, personality: str, autopilot: str,
) -> None:  # fmt: skip
    """Fly a scenario in software: vehicle, target, onboard process and recorder, all over the real wires.

    Exit status: 0 landed, 1 anything else that flew, 2 wrong input.
    """
    from rich.console import Console

    from flightstack.launch import run
    from flightstack.processes import LaunchError
    from flightstack.result import conclude
    from flightstack.run_options import RunOptions

    options = RunOptions(
        scenario,
        seed,
        FilterKind(filter_name) if filter_name else None,
        lockstep,
        duration_s,
        out,
        not as_json,
        signing_key,
        listen,
        zenoh_config,
        ros2_network(ros2_where, ros_domain),
        personality=personality,
        autopilot=autopilot,
    )
    console = Console(stderr=as_json, highlight=False)
    try:
        flown = run(options, console)
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(1)
    sys.exit(conclude(flown, console, as_json=as_json, with_report=with_report))
