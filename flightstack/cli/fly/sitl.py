"""The verb ``sitl``: a whole flight in software, by one command."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes
from flightstack.launch.run_options import Flies

_PROGRAM = click.Path(exists=True, path_type=Path)


def _members(context: click.Context, parameter: click.Parameter, given: tuple[str, ...]) -> dict[int, str]:
    """Turn N=URL into a table."""
    del context, parameter
    found = {}
    for text in given:
        number, equals, url = text.partition("=")
        if not (number.isdecimal() and equals and url):
            raise click.BadParameter(f"found {text!r}; N=URL is needed, for example 2=udpin:127.0.0.1:14541")
        found[int(number)] = url
    return found


@dataclass(frozen=True)
class SitlOptions(shared.Ros2, shared.Result, shared.Scenario):
    """Options of ``sitl``."""

    filter: str | None = shared.safety_filter("Safety filter; default: the configuration's")
    config_file: Path | None = shared.config(
        "Configuration instead of the scenario's, or of the one for an autopilot"
    )
    lockstep: bool = shared.lockstep
    speed: float = shared.speed
    duration_s: float | None = shared.duration
    runs: int = shared.option(
        "--runs", type=click.IntRange(min=1), default=1, metavar="N",
        help="Fly N times, with the seeds from --seed on, and print a summary.",
    )  # fmt: skip
    view: str | None = shared.view
    profile: str = shared.profile
    autopilot: str = shared.autopilot
    accept_release: bool = shared.accept_release
    px4: Path | None = shared.option(
        "--px4", type=_PROGRAM, help="Fly this PX4 (SITL program or build folder) on the simulated vehicle."
    )
    px4_sih: Path | None = shared.option(
        "--px4-sih", type=_PROGRAM, help="Fly this PX4 with its own physics of a 1 kg quadrotor."
    )
    ardupilot: Path | None = shared.option(
        "--ardupilot", type=_PROGRAM, help="Fly this ArduCopter (SITL program) with its own physics."
    )
    instance: int | None = shared.option(
        "--px4-instance", "--instance", type=click.IntRange(0, 9), metavar="N",
        help="Number that selects the ports of PX4 or ArduPilot; default: a free one, ArduPilot 0.",
    )  # fmt: skip
    mocap: bool = shared.mocap
    members: dict[int, str] = shared.option(
        "--member", multiple=True, metavar="N=URL", callback=_members,
        help="MAVLink URL of a vehicle from elsewhere that flies as member N of a team; repeatable "
        "(docs/how_it_works/fleet.md).",
    )  # fmt: skip
    listen: tuple[str, ...] = shared.option(
        "--listen", multiple=True, metavar="ENDPOINT",
        help="Additional Zenoh endpoint for watchers; one on loopback is there and printed; repeatable.",
    )  # fmt: skip
    zenoh_config: Path | None = shared.zenoh_config
    signing_key: Path | None = shared.signing_key


@click.command()
@takes(SitlOptions)
def sitl(options: SitlOptions) -> None:
    """Fly a scenario in software: vehicle, target, onboard process and recorder, over the real wires.

    A scenario of several vehicles (`scenarios` lists them) flies all of them, with an onboard process each.

    Exit status: 0 landed, 1 flown but not landed, 2 wrong input.
    """
    from flightstack.common.processes import LaunchError
    from flightstack.common.terminal import Terminal
    from flightstack.launch import fleet
    from flightstack.launch.fleet_result import conclude_fleet, fly_fleet
    from flightstack.launch.result import conclude
    from flightstack.launch.run_options import RunOptions
    from flightstack.launch.sitl import fly_all, fly_one, run
    from sim.scenarios.team import is_team

    flies, program = _chosen(
        {Flies.PX4: options.px4, Flies.PX4_SIH: options.px4_sih, Flies.ARDUPILOT: options.ardupilot}
    )
    as_json, with_report = options.as_json, options.with_report
    one = options.to(
        RunOptions, config=options.config_file, flies=flies, program=program,
        live=not as_json and options.runs == 1,
    )  # fmt: skip
    one.check()
    console, team = Terminal(stderr=as_json), is_team(options.scenario)
    try:
        if options.runs > 1:
            flies_one = fly_fleet if team else fly_one
            sys.exit(fly_all(one, options.runs, console, flies_one, as_json=as_json, with_report=with_report))
        if team:
            all_flown = fleet.run(one, console)
            sys.exit(conclude_fleet(all_flown, console, as_json=as_json, with_report=with_report))
        flown = run(one, console)
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
