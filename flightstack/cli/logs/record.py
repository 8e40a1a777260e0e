"""The verbs ``record`` and ``report``: they write a log, and the report of a log."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import click

from flightstack.cli import options as shared
from flightstack.cli.options import takes


@dataclass(frozen=True)
class RecordOptions(shared.Options):
    """Options of ``record``."""

    socket_path: Path = shared.option(
        "--socket", required=True, type=click.Path(path_type=Path),
        help="Socket to listen on; the other verbs take it as --recorder.",
    )  # fmt: skip
    out: Path = shared.option("--out", required=True, type=shared.FILE, help="MCAP file to write.")
    until_clients: int | None = shared.option(
        "--until-clients", type=click.IntRange(min=1),
        help="End when this number of clients have disconnected.",
    )  # fmt: skip
    connect: tuple[str, ...] = shared.connect
    zenoh_config: Path | None = shared.zenoh_config
    keys: tuple[str, ...] = shared.option(
        "--key", multiple=True, metavar="EXPR",
        help="Additional Zenoh keys to record, e.g. 'cf1/**'; repeatable.",
    )  # fmt: skip


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
@click.argument("log", type=shared.EXISTING_FILE)
@click.argument("other", type=shared.EXISTING_FILE, required=False)
@click.option(
    "--out",
    type=shared.FILE,
    help="HTML file; default: next to the log, flight.html for flight.mcap, or comparison.html.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="Print the verdict as a JSON object, with the keys of `sitl --json`.",
)
def report(log: Path, other: Path | None, out: Path | None, as_json: bool) -> None:
    """Write the report of a LOG, or a comparison with an OTHER: one self-contained HTML page.

    Prints the verdict on a LOG and where its page is. Exit status: 0 written, 2 wrong input.
    """
    if other is None:
        from flightstack.cli.logs.log import show_verdict
        from logs.reader.flight import load_flight
        from logs.report.report import write_page
        from logs.verdict.verdict import judge, verdict_result

        flight = load_flight(log)
        verdict = judge(flight)
        page = write_page(flight, verdict, out)
        show_verdict(verdict_result(flight, verdict, page), as_json=as_json)
        if not as_json:
            click.echo(page)
    elif as_json:
        raise click.UsageError("--json is for the report of one LOG, not for a comparison")
    else:
        from logs.report.compare import write_comparison

        click.echo(write_comparison(log, other, out))
