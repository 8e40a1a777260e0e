"""The verbs ``log ...``: inspect, judge, compare, cut, repair and export flight logs."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flightstack.cli.options import Number
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
    """Inspect, judge, compare, cut, repair and export flight logs. Of a broken LOG is used what can be read.

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
    from logs.reader.flight import load_fleet, load_flight
    from logs.verdict.fleet import fleet_result, judge_fleet, judge_member
    from logs.verdict.verdict import judge, verdict_result

    if _open(log_file, member).members:
        fleet = load_fleet(log_file)
        values = fleet_result(fleet, judge_fleet(fleet))
    elif member is not None:
        values = verdict_result(*judge_member(log_file, member))
    else:
        flight = load_flight(log_file)
        values = verdict_result(flight, judge(flight))
    show_verdict(values, as_json=as_json)
    sys.exit(LANDED if values["outcome"] == "landed" else NOT_LANDED)


def show_verdict(values: dict[str, Any], *, as_json: bool) -> None:
    """Print a verdict as a table, or as one line of JSON."""
    if as_json:
        click.echo(json.dumps(values))
        return
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import fleet_table, verdict_table

    table = fleet_table if "vehicles" in values else verdict_table
    Terminal().print(table(values, values["reason"]))


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
@click.option(
    "--from", "begin_s", type=Number(0.0), default=0.0, metavar="S",
    help="Begin this time after the first message.",
)  # fmt: skip
@click.option(
    "--to", "end_s", type=Number(0.0), metavar="S",
    help="End this time after the first message; default: the end of the log.",
)  # fmt: skip
@_out
def cut(
    log_file: Path, member: str | None, begin_s: float, end_s: float | None, out: Path, force: bool
) -> None:
    """Write a time span of a LOG; slow and latched topics are repeated at its start."""
    from logs.tools import edit as tools_edit

    edited = tools_edit.cut(_open(log_file, member), begin_s, end_s, out, force=force)
    again = f", {edited.repeated} of them from before the start"
    _end(out, f"{edited.messages} messages{again}", edited.problem)


@log.command("filter")
@_log
@_member
@click.option(
    "--topic", "patterns", multiple=True, required=True, metavar="PATTERN",
    help="Topics to keep, e.g. '/cf1/*'; repeatable.",
)  # fmt: skip
@_out
def filter_(log_file: Path, member: str | None, patterns: tuple[str, ...], out: Path, force: bool) -> None:
    """Write selected topics of a LOG; metadata and attachments are kept."""
    from logs.tools import edit as tools_edit

    edited = tools_edit.select(_open(log_file, member), patterns, out, force=force)
    _end(out, f"{edited.messages} messages", edited.problem)


@log.command()
@_log
@_member
@_out
def recover(log_file: Path, member: str | None, out: Path, force: bool) -> None:
    """Repair a broken LOG: write all messages that can be read, and a new index."""
    from logs.tools import edit as tools_edit

    edited = tools_edit.recover(_open(log_file, member), out, force=force)
    click.echo(plain(f"{out}: {edited.messages} messages; {edited.problem or 'the log was whole'}"))


@log.command()
@_log
@_member
@click.option("--topic", metavar="TOPIC", help="Topic to export; tlog: default both directions.")
@click.option(
    "--format", "kind", type=click.Choice(["csv", "parquet", "tlog"]), required=True,
    help="csv and parquet: one topic as a table; tlog: MAVLink frames for ground stations.",
)  # fmt: skip
@_out
def export(log_file: Path, member: str | None, topic: str | None, kind: str, out: Path, force: bool) -> None:
    """Write one topic of a LOG as a file for other programs."""
    from logs.tools import export as tools_export
    from logs.tools.export import export_tlog

    opened = _open(log_file, member)
    if kind == "tlog":
        text = f"{export_tlog(opened, out, topic=topic, force=force)} frames"
    else:
        if topic is None:
            raise click.UsageError(f"--format {kind} needs --topic; `flightstack log info` lists them")
        write: dict[str, Callable[..., int]] = {
            "csv": tools_export.export_csv,
            "parquet": tools_export.export_parquet,
        }
        text = f"{write[kind](opened, topic, out, force=force)} rows"
    _end(out, text, opened.why_broken)


def _open(path: Path, member: str | None) -> LogFile:
    from logs.reader.reader import LogFile

    return LogFile(path, member)


def _end(out: Path, text: str, problem: str) -> Any:
    """Print what was written, and whether the log was broken."""
    click.echo(plain(f"{out}: {text}"))
    if problem:
        click.echo(plain(f"flightstack: the log is broken; what can be read was used: {problem}"), err=True)
    sys.exit(BROKEN if problem else DONE)
