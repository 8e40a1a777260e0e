"""The verb ``sitl``: a whole flight in software, by one command."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from flightstack.cli import options as shared
from flightstack.cli.options import ros2, ros2_network, zenoh_config
from flightstack.launch.run_options import Flies

_PROGRAM = click.Path(exists=True, path_type=Path)


@click.command()
@shared.scenario()
@shared.seed
@shared.safety_filter("Safety filter; default: the configuration's")
@shared.lockstep
@shared.duration
@shared.out
@shared.as_json
@shared.with_report
@shared.signing_key
@ros2
@zenoh_config
@shared.view
@shared.personality
@shared.autopilot
@click.option(
    "--listen", multiple=True, metavar="ENDPOINT",
    help="Additional Zenoh endpoint for watchers; one on loopback is always there and printed; repeatable.",
)  # fmt: skip
@shared.config(required=False, help="Configuration instead of the scenario's, or of the one for an autopilot")
@click.option(
    "--px4", type=_PROGRAM, help="Fly this PX4 (SITL program or build folder) on the simulated vehicle."
)
@click.option("--px4-sih", type=_PROGRAM, help="Fly this PX4 with its own physics of a 1 kg quadrotor.")
@click.option("--ardupilot", type=_PROGRAM, help="Fly this ArduCopter (SITL program) with its own physics.")
@click.option(
    "--px4-instance", "--instance", "instance", type=click.IntRange(0, 9), metavar="N",
    help="Instance number, which selects the ports of PX4 or ArduPilot; default: a free one, ArduPilot 0.",
)  # fmt: skip
@click.option("--mocap", is_flag=True, help="Give PX4 the scenario's motion capture instead of satellites.")
@shared.speed
@click.option(
    "--runs", type=click.IntRange(min=1), default=1, show_default=True, metavar="N",
    help="Fly N times, with the seeds from --seed on, and print a summary.",
)  # fmt: skip
def sitl(
    filter_name: str | None, as_json: bool, with_report: bool, px4: Path | None, px4_sih: Path | None,
    ardupilot: Path | None, ros2_where: str | None, ros_domain: int, runs: int, config_file: Path | None,
    **given: Any,
) -> None:  # fmt: skip
    """Fly a scenario in software: vehicle, target, onboard process and recorder, over the real wires.

    Exit status: 0 landed, 1 flown but not landed, 2 wrong input.
    """
    from rich.console import Console

    from flightstack.common.processes import LaunchError
    from flightstack.launch.result import conclude
    from flightstack.launch.run_options import RunOptions
    from flightstack.launch.sitl import fly_all, run

    flies, program = _chosen({Flies.PX4: px4, Flies.PX4_SIH: px4_sih, Flies.ARDUPILOT: ardupilot})
    options = RunOptions(
        **given,
        filter=filter_name,
        live=not as_json and runs == 1,
        ros2=ros2_network(ros2_where, ros_domain),
        config=str(config_file) if config_file is not None else None,
        flies=flies,
        program=program,
    )
    options.check()
    console = Console(stderr=as_json, highlight=False)
    try:
        if runs > 1:
            sys.exit(fly_all(options, runs, console, as_json=as_json, with_report=with_report))
        flown = run(options, console)
    except LaunchError as error:
        click.echo(f"flightstack: {error}", err=True)
        sys.exit(error.code)
    sys.exit(conclude(flown, console, as_json=as_json, with_report=with_report))


def _chosen(programs: dict[Flies, Path | None]) -> tuple[Flies, Path | None]:
    """Return which autopilot flies, and its program.

    Raises:
        click.UsageError: more than one program was given.
    """
    found = [(flies, program) for flies, program in programs.items() if program is not None]
    if len(found) > 1:
        raise click.UsageError(f"only one of {', '.join(flies.value for flies in programs)} can be flown")
    return found[0] if found else (Flies.OWN, None)
