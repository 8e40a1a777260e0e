"""The verbs ``log ...``: inspect, judge, compare, repair and export flight logs."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flightstack.common.text import plain

if TYPE_CHECKING:
    from logs.reader.reader import LogFile

DONE, BROKEN = 0, 1
LANDED, NOT_LANDED = 0, 1
SHOWN = 20  # differences printed; the first ones tell the story

_log = click.argument("log_file", metavar="LOG", type=click.Path(dir_okay=False, path_type=Path))
_member = click.option("--member", metavar="NAME", help="Only the part of this member of a fleet, e.g. cf2.")
_force = click.option("--force", is_flag=True, help="Replace OUT if it exists.")


def _out(command: Callable[..., None]) -> Callable[..., None]:
    option = click.option(
        "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="File to write."
    )
    return option(_force(command))


@click.group()
def log() -> None:
    """Inspect, judge, compare, repair and export flight logs. Of a broken LOG is used what can be read.

    Exit status: 0 done, 1 the LOG is broken (what can be read was used) or differs, 2 wrong input.
    """


@log.command()
@_log
@_member
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def info(log_file: Path, member: str | None, as_json: bool) -> None:
    """Show duration, topics, metadata and attachments of a LOG, and whether it is complete."""
    from logs.tools import info as tools_info

    found = tools_info.gather(_open(log_file, member))
    click.echo(json.dumps(found.as_json()) if as_json else plain("\n".join(tools_info.lines(found))))
    sys.exit(DONE if found.complete else BROKEN)


@log.command()
@_log
@_member
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object, with the keys of `sitl --json`."
)
def verdict(log_file: Path, member: str | None, as_json: bool) -> None:
    """Judge the flight in a LOG from true states, or a real flight from the vehicle's own estimate.

    A fleet has landed when all its members have.

    Exit status: 0 landed, 1 anything else that flew, 2 the LOG cannot be read.
    """
    from logs.verdict.verdict import fleet_result, judged

    values = fleet_result(*judged(log_file, member))
    show_verdict(values, as_json=as_json)
    sys.exit(LANDED if values["outcome"] == "landed" else NOT_LANDED)


def show_verdict(values: dict[str, Any], *, as_json: bool) -> None:
    """Print a verdict as a table, or as one line of JSON."""
    if as_json:
        click.echo(json.dumps(values))
        return
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import result_table

    Terminal().print(result_table(values, values["reason"]))


@log.command()
@click.argument("log_a", type=click.Path(dir_okay=False, path_type=Path))
@click.argument("log_b", type=click.Path(dir_okay=False, path_type=Path))
def diff(log_a: Path, log_b: Path) -> None:
    """Compare two logs message by message; exit status 0 equal, 1 different.

    Wall-clock measurements (loop timing) are left out.
    """
    from logs.tools.compare import compare

    differences = compare(log_a, log_b)
    for difference in differences[:SHOWN]:
        click.echo(plain(str(difference)))
    if len(differences) > SHOWN:
        click.echo(f"... and {len(differences) - SHOWN} more")
    click.echo("equal" if not differences else f"{len(differences)} differences")
    sys.exit(1 if differences else 0)


@log.command()
@_log
@_member
@_out
def recover(log_file: Path, member: str | None, out: Path, force: bool) -> None:
    """Repair a broken LOG: write all messages that can be read, and a new index."""
    from logs.tools.recover import recover as recovered

    new = recovered(_open(log_file, member), out, force=force)
    click.echo(plain(f"{out}: {new.messages} messages; {new.problem or 'the log was whole'}"))


@log.command()
@_log
@_member
@click.option("--topic", metavar="TOPIC", required=True, help="Topic to export; `log info` lists them.")
@click.option("--format", "kind", type=click.Choice(["csv", "parquet"]), required=True)
@_out
def export(log_file: Path, member: str | None, topic: str, kind: str, out: Path, force: bool) -> None:
    """Write one topic of a LOG as a table for other programs."""
    from logs.tools.export import export_csv, export_parquet

    opened = _open(log_file, member)
    write = export_csv if kind == "csv" else export_parquet
    rows = write(opened, topic, out, force=force)
    click.echo(plain(f"{out}: {rows} rows"))
    if problem := opened.why_broken:
        click.echo(plain(f"flightstack: the log is broken; what can be read was used: {problem}"), err=True)
    sys.exit(BROKEN if problem else DONE)


def _open(path: Path, member: str | None) -> LogFile:
    from logs.reader.reader import LogFile

    return LogFile(path, member)
