"""The verbs ``record`` and ``report``: they write a log, and the report of a log."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from flightstack.cli.options import connect as _connect
from flightstack.cli.options import zenoh_config


@click.command()
@click.option(
    "--socket",
    "socket_path",
    required=True,
    type=click.Path(path_type=Path),
    help="Socket to listen on; the other verbs take it as --recorder.",
)
@click.option(
    "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="MCAP file to write."
)
@click.option(
    "--until-clients", type=click.IntRange(min=1), help="End when this number of clients have disconnected."
)
@_connect
@zenoh_config
@click.option(
    "--key",
    "keys",
    multiple=True,
    metavar="EXPR",
    help="Additional Zenoh keys to record, e.g. 'cf1/**'; repeatable.",
)
def record(
    socket_path: Path, out: Path, until_clients: int | None, connect: tuple[str, ...], keys: tuple[str, ...],
    zenoh_config: Path | None,
) -> None:  # fmt: skip
    """Record what the other processes send, until Ctrl-C; the log is readable at any time."""
    from logs.recorder.recorder import record_main

    sys.exit(
        record_main(socket_path, out, until_clients, connect=connect, keys=keys, config_file=zenoh_config)
    )


@click.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("other", type=click.Path(exists=True, dir_okay=False, path_type=Path), required=False)
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
