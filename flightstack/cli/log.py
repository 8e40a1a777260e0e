"""Commands ``log ...`` and ``compare``: summary, verdict, repair, tables and differences of logs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import click

from flightstack.common.options import Option, arguments
from flightstack.common.text import plain
from flightstack.config import options as shared

DONE, BROKEN = 0, 1
LANDED, NOT_LANDED = 0, 1
DIFFERENCES_MAX = 20  # maximum number of printed differences; the first ones are the most useful

Log = Annotated[Path, Option("LOG")]
Out = Annotated[Path, Option("--out", "File to write.", path="file")]
Force = Annotated[bool, Option("--force", "Replace files that exist.")]
JsonVerdict = Annotated[bool, Option("--json", "Print one JSON object, with the keys of `sitl --json`.")]


@click.group()
def log() -> None:
    """Inspect, judge, compare, repair and export flight logs. The readable part of a broken LOG is used.

    Exit status: 0 done, 1 the LOG is broken (its readable part was used) or differs, 2 wrong input.
    """


@log.command()
@arguments
def info(log_file: Log, member: shared.Member = None, as_json: shared.AsJson = False) -> None:
    """Show duration, topics, metadata and attachments of a LOG, and whether it is complete."""
    from logs.reader.reader import LogFile
    from logs.tools import summary, summary_lines

    found = summary(LogFile(log_file, member))
    click.echo(json.dumps(found) if as_json else plain("\n".join(summary_lines(found))))
    sys.exit(DONE if found["complete"] else BROKEN)


@log.command()
@arguments
def recover(log_file: Log, out: Out, force: Force = False) -> None:
    """Repair a broken LOG: write a complete file with an index and all readable records."""
    from logs.reader.reader import LogFile
    from logs.tools import recover as recovered

    log = LogFile(log_file)
    with new_file(out, force=force) as part:
        messages = recovered(log, part)
    click.echo(plain(f"{out}: {messages} messages; {log.problem or 'the log was complete'}"))


@log.command()
@arguments
def export(
    log_file: Log,
    topic: Annotated[str, Option("--topic", "Topic to export; `log info` lists them.", "TOPIC")],
    kind: Annotated[str, Option(
        "--format", "Format of OUT; parquet needs the extra `export` and enough memory for the whole table.",
        choices=("csv", "parquet"),
    )],
    out: Out,
    force: Force = False,
) -> None:  # fmt: skip
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
@arguments
def verdict(log_file: Log, as_json: JsonVerdict = False) -> None:
    """Judge the flight in a LOG from the true states, or a real flight from the vehicle's own estimate.

    A fleet has landed when all its members have landed.

    Exit status: 0 landed, 1 any other end of a flight, 2 the LOG cannot be read.
    """
    from logs.verdict.verdict import judged, result

    values = result(*judged(log_file))
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
@arguments
def compare(log_a: Annotated[Path, Option("LOG_A")], log_b: Annotated[Path, Option("LOG_B")]) -> None:
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
