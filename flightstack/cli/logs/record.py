"""The verbs ``record`` and ``report``: they write a log, and the report of a log."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click

from flightstack.cli.options import takes
from flightstack.common.options import Option
from flightstack.config import options as shared


@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """Options of ``record``."""

    socket_path: Annotated[
        Path, Option("--socket", "Socket to listen on; the other verbs take it as --recorder.")
    ]
    out: Annotated[Path, Option("--out", "MCAP file to write.", path="file")]
    until_clients: Annotated[int | None, Option(
        "--until-clients", "End when this number of clients have disconnected.", span=(1, None)
    )] = None  # fmt: skip
    connect: shared.Connect = ()
    zenoh_config: shared.ZenohConfig = None
    keys: Annotated[tuple[str, ...], Option(
        "--key", "Additional Zenoh keys to record, e.g. 'cf1/**'; repeatable.", "EXPR"
    )] = ()  # fmt: skip


@click.command()
@takes(RecordOptions)
def record(options: RecordOptions) -> None:
    """Record what the other processes send, until Ctrl-C; the log is readable at any time."""
    from logs.recorder.recorder import record_main

    sys.exit(
        record_main(
            options.socket_path, options.out, options.until_clients, connect=options.connect,
            keys=options.keys, config_file=options.zenoh_config,
        )
    )  # fmt: skip


@click.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("other", type=click.Path(exists=True, dir_okay=False, path_type=Path), required=False)
@click.option("--member", metavar="NAME", help="Take the flight of this member of a fleet, e.g. cf2.")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="HTML file; default: next to the log, flight.html for flight.mcap, or comparison.html.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the verdict as a JSON object, with the keys of `sitl --json`.",
)
def report(log: Path, other: Path | None, member: str | None, out: Path | None, as_json: bool) -> None:
    """Write the report of a LOG, or a comparison with an OTHER: one self-contained HTML page.

    Of a fleet: a page of all together, and one of each member beside it.

    Prints the verdict on a LOG and where its page is. Exit status: 0 written, 2 wrong input.
    """
    from logs.report.report import write_comparison, write_report

    if other is None:
        from flightstack.cli.logs.log import show_verdict
        from logs.verdict.verdict import fleet_result, judged

        fleet, verdict = judged(log, member)
        values = fleet_result(fleet, verdict, write_report(fleet, verdict, out))
        show_verdict(values, as_json=as_json)
        if not as_json:
            click.echo(values["report"])
    elif as_json:
        raise click.UsageError("--json is for the report of one LOG, not for a comparison")
    else:
        click.echo(write_comparison(log, other, out, member))
