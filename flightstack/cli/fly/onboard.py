"""The verb ``onboard``: the onboard process."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes
from flightstack.common.hangup import say


@dataclass(frozen=True)
class OnboardOptions(shared.Flight):
    """Options of ``onboard``."""

    recorder: Path | None = shared.recorder
    lockstep: bool = shared.lockstep
    speed: float = shared.speed
    clock: Path | None = shared.clock
    shared_log: bool = shared.option(
        "--shared-log", is_flag=True,
        help="The recorder writes several flights: names in the log begin with the namespace.",
    )  # fmt: skip


@click.command()
@takes(OnboardOptions)
def onboard(options: OnboardOptions) -> None:
    """Run the onboard process with any vehicle and target; `fly` adds a live view and a report.

    It records to a log in runs/ unless --recorder or --no-record is given. Ctrl-C, or closing the terminal,
    aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land where it is and ends the process.
    """
    from bridge.target.ros2_target import TargetType
    from flightstack.common.processes import LaunchError
    from flightstack.compiled.core import Core
    from flightstack.config.files import load
    from flightstack.onboard import process
    from flightstack.onboard.fleet_wire import namespace_of
    from flightstack.onboard.recording import OwnRecorder

    with ExitStack() as stack:
        records = options.recorder is None and not options.no_record
        own = stack.enter_context(OwnRecorder()) if records else None
        target_type = TargetType(options.target_type)
        config = load(options.config_file)
        namespace = options.namespace or namespace_of(config)
        plugged = options.to(
            process.Options, own_recorder=own, target_type=target_type, namespace=namespace,
            core=Core(options.core),
        )  # fmt: skip
        try:
            ended = process.run(config, plugged, say=say)
        except LaunchError as error:
            click.echo(f"flightstack: {error}; --no-record flies without a log", err=True)
            sys.exit(1)
    say(f"{ended.phase.name}: {ended.reason}")
    if own is not None and own.problem is not None:
        click.echo(f"onboard: WARNING: {own.problem}", err=True)
    sys.exit(ended.exit_code)
