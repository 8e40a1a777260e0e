"""Commands ``log ...`` and ``compare``: summary, verdict, repair, tables and differences of logs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from flightstack.common.text import plain

DONE, BROKEN = 0, 1
LANDED, NOT_LANDED = 0, 1
DIFFERENCES_MAX = 20  # maximum number of printed differences; the first ones are the most useful

_log = click.argument("log_file", metavar="LOG", type=click.Path(path_type=Path))
_out = click.option(
    "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="File to write."
)
_force = click.option("--force", is_flag=True, help="Replace OUT if it exists.")
_member = click.option("--member", metavar="NAME", help="Only the part of this member of a fleet, e.g. cf2.")


@click.group()
def log() -> None:
    """Inspect, judge, compare, repair and export flight logs. The readable part of a broken LOG is used.

    Exit status: 0 done, 1 the LOG is broken (its readable part was used) or differs, 2 wrong input.
    """


@log.command()
@_log
@_member
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def info(log_file: Path, member: str | None, as_json: bool) -> None:
    """Show duration, topics, metadata and attachments of a LOG, and whether it is complete."""
    from logs.reader.reader import LogFile
    from logs.tools import summary, summary_lines

    found = summary(LogFile(log_file, member))
    click.echo(json.dumps(found) if as_json else plain("\n".join(summary_lines(found))))
    sys.exit(DONE if found["complete"] else BROKEN)


@log.command()
@_log
@_out
@_force
def recover(log_file: Path, out: Path, force: bool) -> None:
    """Repair a broken LOG: write a complete file with an index and all readable records."""
    from logs.reader.reader import LogFile
    from logs.tools import recover as recovered

    log = LogFile(log_file)
    with new_file(out, force=force) as part:
        messages = recovered(log, part)
    click.echo(plain(f"{out}: {messages} messages; {log.problem or 'the log was complete'}"))


@log.command()
@_log
@click.option("--topic", metavar="TOPIC", required=True, help="Topic to export; `log info` lists them.")
@click.option(
    "--format", "kind", type=click.Choice(["csv", "parquet"]), required=True,
    help="Format of OUT; parquet needs the extra `export` and enough memory for the whole table.",
)  # fmt: skip
@_out
@_force
def export(log_file: Path, topic: str, kind: str, out: Path, force: bool) -> None:
    """Write one topic of a LOG as a table: one row for each message, with its times and sequence number.

    Nested fields have dotted names; a list is one column with JSON text.
    """
    from logs.reader.reader import LogFile
    from logs.tools import Table, export_csv, export_parquet

    table = Table(LogFile(log_file), topic)
    with new_file(out, force=force) as part:
        rows = (export_csv if kind == "csv" else export_parquet)(table, part)
    click.echo(plain(f"{out}: {rows} rows"))
    if problem := "; ".join(filter(None, (table.log.problem, table.problem))):
        click.echo(plain(f"flightstack: the log is broken; what can be read was used: {problem}"), err=True)
    sys.exit(BROKEN if problem else DONE)


@log.command()
@_log
@_member
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object, with the keys of `sitl --json`."
)
def verdict(log_file: Path, member: str | None, as_json: bool) -> None:
    """Judge the flight in a LOG from the true states, or a real flight from the vehicle's own estimate.

    A fleet has landed when all its members have landed.

    Exit status: 0 landed, 1 any other end of a flight, 2 the LOG cannot be read.
    """
    from logs.verdict.verdict import judged, result

    values = result(*judged(log_file, member))
    show_verdict(values, as_json=as_json)
    sys.exit(LANDED if values["outcome"] == "landed" else NOT_LANDED)


def show_verdict(values: dict[str, Any], *, as_json: bool) -> None:
    """Print a verdict as a table, or as one line of JSON."""
    if as_json:
        click.echo(json.dumps(values))
        return
    from flightstack.common.terminal import Terminal
    from flightstack.launch.result import result_table

    Terminal().print(result_table(values))


@click.command()
@click.argument("log_a", type=click.Path(path_type=Path))
@click.argument("log_b", type=click.Path(path_type=Path))
def compare(log_a: Path, log_b: Path) -> None:
    """Compare two logs message by message; exit status 0 equal, 1 different.

    The last line names the first tick with a difference. Wall-clock measurements (loop timing) are not
    compared.
    """
    from logs.compare import compare as differences_of
    from logs.compare import first_tick

    differences = differences_of(log_a, log_b)
    for difference in differences[:DIFFERENCES_MAX]:
        click.echo(plain(str(difference)))
    if len(differences) > DIFFERENCES_MAX:
        click.echo(f"... and {len(differences) - DIFFERENCES_MAX} more")
    click.echo("equal" if not differences else f"{len(differences)} differences")
    if differences and (tick := first_tick(log_a, log_b)) is not None:
        click.echo(f"the first tick that differs: {tick}")
    sys.exit(1 if differences else 0)


log.add_command(compare, "diff")


@contextmanager
def new_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary name next to ``path``; after success the file gets its final name."""
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists and is not overwritten; give another name or --force")
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        error.filename = error.filename or str(path)  # a full disk has no name of a file
        raise
    finally:
        part.unlink(missing_ok=True)
