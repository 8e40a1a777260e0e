"""The verb ``onboard``: the onboard process."""

from __future__ import annotations

import sys
from contextlib import ExitStack

import click

from flightstack.cli.options import takes
from flightstack.common.hangup import say
from flightstack.onboard.options import OnboardOptions


@click.command()
@takes(OnboardOptions)
def onboard(options: OnboardOptions) -> None:
    """Run the onboard process with any vehicle and target; `fly` adds a live view and a report.

    It records to a log in runs/ unless --recorder or --no-record is given. Ctrl-C, or closing the terminal,
    aborts: the vehicle flies clear and lands. A second Ctrl-C makes it land where it is and ends the process.
    """
    from flightstack.common.processes import LaunchError
    from flightstack.config.files import load
    from flightstack.onboard import process
    from flightstack.onboard.recording import OwnRecorder

    with ExitStack() as stack:
        records = options.recorder is None and not options.no_record
        own = stack.enter_context(OwnRecorder()) if records else None
        try:
            ended = process.run(load(options.config_file), options, say, own)
        except LaunchError as error:
            raise LaunchError(f"{error}; --no-record flies without a log") from error
    say(f"{ended.phase.name}: {ended.reason}")
    if own is not None and own.problem is not None:
        click.echo(f"onboard: WARNING: {own.problem}", err=True)
    sys.exit(ended.exit_code)
