"""The verb ``onboard``: the onboard process."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from flightstack.cli import options as shared
from flightstack.cli.options import plugs, ros2, ros2_network, target_key, target_offset, target_type
from flightstack.common.hangup import say

_FLIGHT = (
    shared.vehicle_url, target_key, target_type, target_offset, ros2, shared.config(), plugs,
    shared.namespace, shared.no_record, shared.duration, shared.system_id, shared.autopilot,
    shared.signing_key, shared.allow_unsigned,
)  # fmt: skip


def flight_options(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Options of the verbs that fly any vehicle: vehicle, target, configuration, links."""
    for option in reversed(_FLIGHT):
        verb = option(verb)
    return verb


@click.command()
@flight_options
@shared.recorder
@shared.lockstep
@shared.speed
@shared.clock
def onboard(config_file: Path, recorder: Path | None, no_record: bool, **plugged: Any) -> None:
    """Run the onboard process with any vehicle and target; `fly` adds a live view and a report.

    It records to a log in runs/ unless --recorder or --no-record is given. Ctrl-C, or closing the terminal,
    aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land where it is and ends the process.
    """
    from bridge.target.ros2_target import TargetType
    from flightstack.common.processes import LaunchError
    from flightstack.config import files as config
    from flightstack.onboard import process
    from flightstack.onboard.recording import OwnRecorder

    with ExitStack() as stack:
        own = stack.enter_context(OwnRecorder()) if recorder is None and not no_record else None
        options = process.Options(
            vehicle_url=plugged["vehicle_url"],
            target_key=plugged["target_key"],
            connect=list(plugged["connect"]),
            listen=list(plugged["listen"]),
            namespace=plugged["namespace"],
            recorder=recorder,
            own_recorder=own,
            lockstep=plugged["lockstep"],
            duration_s=plugged["duration_s"],
            system_id=plugged["system_id"],
            signing_key=plugged["signing_key"],
            allow_unsigned=plugged["allow_unsigned"],
            autopilot=plugged["autopilot"],
            target_type=TargetType(plugged["target_type"]),
            zenoh_config=plugged["zenoh_config"],
            ros2=ros2_network(plugged["ros2_where"], plugged["ros_domain"]),
            ros_domain=plugged["ros_domain"],
            target_offset_m=plugged["target_offset"],
            speed=plugged["speed"],
            clock=plugged["clock"],
        )
        try:
            ended = process.run(config.load(config_file), options, say=say)
        except LaunchError as error:
            click.echo(f"flightstack: {error}; --no-record flies without a log", err=True)
            sys.exit(1)
    say(f"{ended.phase.name}: {ended.reason}")
    if own is not None and own.problem is not None:
        click.echo(f"onboard: WARNING: {own.problem}", err=True)
    sys.exit(ended.exit_code)
