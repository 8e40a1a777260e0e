"""The verb ``onboard``: the process that flies."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from flightstack import cli_options as shared
from flightstack.cli_zenoh import plugs, ros2, ros2_network, target_key, target_offset, target_type
from flightstack.hangup import say


@click.command()
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
@shared.speed
def onboard(
    vehicle_url: str, target_key: str, config_file: Path, connect: tuple[str, ...], listen: tuple[str, ...],
    namespace: str, recorder: Path | None, lockstep: bool, duration_s: float | None, system_id: int,
    autopilot: str, signing_key: Path | None, allow_unsigned: bool, target_type: str, ros2_where: str | None,
    ros_domain: int, zenoh_config: Path | None, target_offset: tuple[float, float, float],
    speed: float,
) -> None:  # fmt: skip
    """Run the onboard process against any vehicle and target.

    Ctrl-C asks for an abort (fly clear, land), and so does a terminal that closes; a second Ctrl-C ends the
    process at once.
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
        speed,
    )
    ended = process.run(config.load(config_file), options, say=say)
    say(f"{ended.phase.name}: {ended.reason}")
    sys.exit(ended.exit_code)
