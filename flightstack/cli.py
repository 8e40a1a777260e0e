"""The command ``flightstack``: verbs only, the work is elsewhere."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Any

import click

from flightstack import cli_options as shared
from flightstack.cli_bridge import bridge
from flightstack.cli_check import check
from flightstack.cli_identify import identify
from flightstack.cli_log import diff, log
from flightstack.cli_preflight import preflight
from flightstack.cli_px4_sim import px4_sim
from flightstack.cli_replay import replay
from flightstack.cli_view import view
from flightstack.cli_watch import watch
from flightstack.cli_zenoh import connect as _connect
from flightstack.cli_zenoh import (
    plugs,
    ros2,
    ros2_network,
    router,
    target_key,
    target_offset,
    target_type,
    zenoh_config,
)
from flightstack.config import FilterKind
from flightstack.strict_toml import ConfigError
from sim.campaign.verb import campaign

LANDED, FLEW, WRONG_INPUT = 0, 1, 2

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}


class Verbs(click.Group):
    """Turns wrong input into one clear line and exit status 2."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb."""
        try:
            return super().invoke(ctx)
        except (ConfigError, ValueError, OSError) as error:
            click.echo(f"flightstack: {error}", err=True)
            ctx.exit(WRONG_INPUT)


@click.group(cls=Verbs, context_settings=CONTEXT)
@click.version_option(package_name="crazyflie-flightstack", message="flightstack %(version)s")
def main() -> None:
    """Land a Crazyflie on a moving target: safely, over MAVLink and Zenoh, everything recorded."""


def _say(text: str) -> None:
    """Print a line, unless nobody listens any more: a closed terminal must not end a flight."""
    with contextlib.suppress(BrokenPipeError):
        click.echo(text)


@main.command()
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
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for log and report; default: a new one in runs/.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object as the last line.")
@click.option(
    "--report/--no-report", "with_report", default=True, show_default=True, help="Write the HTML report."
)
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
    from flightstack import sitl as runner
    from flightstack.launch import RunOptions

    kind = FilterKind(filter_name) if filter_name else None
    network = ros2_network(ros2_where, ros_domain)
    options = RunOptions(
        scenario,
        seed,
        kind,
        lockstep,
        duration_s,
        out,
        not as_json,
        signing_key,
        listen,
        zenoh_config,
        network,
        personality=personality,
        autopilot=autopilot,
    )
    sys.exit(runner.fly(options, as_json=as_json, with_report=with_report))


@main.command()
@shared.vehicle_url
@target_key
@target_type
@target_offset
@ros2
@click.option(
    "--config",
    "config_file",
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Configuration (TOML).",
)
@plugs
@shared.namespace
@shared.recorder
@shared.lockstep
@shared.duration
@shared.system_id
@shared.autopilot
@shared.signing_key
@shared.allow_unsigned
def onboard(
    vehicle_url: str, target_key: str, config_file: Path, connect: tuple[str, ...], listen: tuple[str, ...],
    namespace: str, recorder: Path | None, lockstep: bool, duration_s: float | None, system_id: int,
    autopilot: str, signing_key: Path | None, allow_unsigned: bool, target_type: str, ros2_where: str | None,
    ros_domain: int, zenoh_config: Path | None, target_offset: tuple[float, float, float],
) -> None:  # fmt: skip
    """Run the onboard process against any vehicle and target.

    Ctrl-C asks for an abort (fly clear, land); a second one ends the process at once.
    """
    from bridge.ros2_target import TargetType
    from flightstack import config
    from flightstack import onboard as process

    options = process.Options(
        vehicle_url,
        target_key,
        list(connect),
        list(listen),
        namespace,
        recorder,
        lockstep,
        duration_s,
        system_id,
        signing_key,
        allow_unsigned,
        autopilot,
        TargetType(target_type),
        zenoh_config,
        ros2_network(ros2_where, ros_domain),
        ros_domain,
        target_offset,
    )
    ended = process.run(config.load(config_file), options, say=_say)
    _say(f"{ended.phase.name}: {ended.reason}")
    sys.exit(ended.exit_code)


@main.command()
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
    """Run the simulated Crazyflie as a MAVLink vehicle; its deck follows the target's truth on Zenoh."""
    from sim.scenario import load
    from sim.vehicle_process import vehicle_main

    sys.exit(
        vehicle_main(
            load(scenario), seed, url, lockstep=lockstep, rate_hz=rate_hz,
            feed_socket=str(recorder) if recorder else None, zenoh_connect=list(connect),
            zenoh_listen=list(listen), namespace=namespace, duration_s=duration_s, peers=list(peers),
            signing_key=signing_key, allow_unsigned=allow_unsigned, zenoh_config=zenoh_config,
            personality=personality, parameters=parameters,
        )
    )  # fmt: skip


@main.command()
@shared.scenario()
@shared.seed
@plugs
@ros2
@shared.namespace
@shared.recorder
@shared.rate
@shared.lockstep
@shared.duration
def target(
    scenario: str, seed: int, connect: tuple[str, ...], listen: tuple[str, ...], namespace: str,
    recorder: Path | None, rate_hz: int, lockstep: bool, duration_s: float | None, zenoh_config: Path | None,
    ros2_where: str | None, ros_domain: int,
) -> None:  # fmt: skip
    """Run the ground robot: drives the scenario's path and publishes its odometry on Zenoh."""
    from sim.scenario import load
    from sim.target_process import target_main

    sys.exit(
        target_main(
            load(scenario), seed, lockstep=lockstep, rate_hz=rate_hz, listen=list(listen),
            connect=list(connect), namespace=namespace, duration_s=duration_s,
            feed_socket=str(recorder) if recorder else None, zenoh_config=zenoh_config,
            ros2=ros2_network(ros2_where, ros_domain),
        )
    )  # fmt: skip


@main.command()
@click.option(
    "--socket",
    "socket_path",
    required=True,
    type=click.Path(path_type=Path),
    help="Socket to serve; the other verbs take it as --recorder.",
)
@click.option(
    "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="MCAP file to write."
)
@click.option(
    "--until-clients", type=click.IntRange(min=1), help="End after so many clients have come and gone."
)
@_connect
@zenoh_config
@click.option(
    "--key",
    "keys",
    multiple=True,
    metavar="EXPR",
    help="Zenoh keys to record besides, e.g. 'cf1/**'; repeatable.",
)
def record(
    socket_path: Path, out: Path, until_clients: int | None, connect: tuple[str, ...], keys: tuple[str, ...],
    zenoh_config: Path | None,
) -> None:  # fmt: skip
    """Record what the other processes send, until ended; the log is readable at any time."""
    from logs.recorder import record_main

    sys.exit(
        record_main(socket_path, out, until_clients, connect=connect, keys=keys, config_file=zenoh_config)
    )


@main.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("other", type=click.Path(exists=True, dir_okay=False, path_type=Path), required=False)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="HTML file; default: next to the log, flight.html for flight.mcap, or comparison.html.",
)
def report(log: Path, other: Path | None, out: Path | None) -> None:
    """Write the report of a LOG, or a comparison with an OTHER: one self-contained HTML page."""
    if other is None:
        from logs.report import write_report

        click.echo(write_report(log, out))
    else:
        from logs.report_compare import write_comparison

        click.echo(write_comparison(log, other, out))


@main.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
def key(file: Path) -> None:
    """Make a MAVLink signing key in a new FILE that its owner alone can read (docs/security.md)."""
    from bridge.signing_key import make_key

    make_key(file)
    click.echo(f"{file}: a new signing key; give it to both ends as --signing-key, over a channel you trust")


@main.command()
@click.argument("name", required=False)
def scenarios(name: str | None) -> None:
    """List the scenarios that come with the simulator, or print the one NAMEd."""
    from sim import scenario

    if name is not None:
        click.echo(scenario.path_of(name).read_text(), nl=False)
        return
    for known in scenario.names():
        click.echo(f"{known:18} {scenario.load(known).description}")


main.add_command(bridge)
main.add_command(check)
main.add_command(identify)
main.add_command(preflight)
main.add_command(px4_sim)
main.add_command(replay)
main.add_command(watch)
main.add_command(router)
main.add_command(campaign)
main.add_command(log)
main.add_command(view)
main.add_command(diff, "compare")

if __name__ == "__main__":
    main()
