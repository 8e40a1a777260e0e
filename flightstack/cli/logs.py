"""Commands for flight logs: record, replay, report, view, identify, compare, and ``log ...``."""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from flightstack.common.options import Option, arguments, takes
from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import plain
from flightstack.config import options as shared
from flightstack.core.parameters.filters import FILTERS

if TYPE_CHECKING:
    from logs.replay.replay import Result

DONE, BROKEN = 0, 1
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
    from logs.tools import export_csv, export_parquet, rows

    log, refused = LogFile(log_file), Counter[str]()
    with new_file(out, force=force) as part:
        number = (export_csv if kind == "csv" else export_parquet)(rows(log, topic, refused), part)
    click.echo(plain(f"{out}: {number} rows"))
    problems = [log.problem] if log.problem else []
    if refused:
        first = next(iter(refused))
        problems.append(f"{refused.total()} messages of {topic} cannot be decoded; first: {first}")
    if problems:
        text = f"flightstack: the log is broken; what can be read was used: {'; '.join(problems)}"
        click.echo(plain(text), err=True)
    sys.exit(BROKEN if problems else DONE)


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
    sys.exit(values["outcome"] != "landed")


def show_verdict(values: dict[str, Any], *, as_json: bool) -> None:
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
    from logs.compare import compare as compared

    differences, tick = compared(log_a, log_b)
    for difference in differences[:DIFFERENCES_MAX]:
        click.echo(plain(str(difference)))
    if len(differences) > DIFFERENCES_MAX:
        click.echo(f"... and {len(differences) - DIFFERENCES_MAX} more")
    click.echo("equal" if not differences else f"{len(differences)} differences")
    if tick is not None:
        click.echo(f"the first tick that differs: {tick}")
    sys.exit(1 if differences else 0)


log.add_command(compare, "diff")


@contextmanager
def new_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary name beside ``path``; after success rename the temporary file to ``path``."""
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists and is not overwritten; give another name or --force")
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        error.filename = error.filename or str(path)  # the error of a full disk contains no file name
        raise
    finally:
        part.unlink(missing_ok=True)


@click.command()
@arguments
def identify(
    logs: Annotated[tuple[Path, ...], Option("LOG...", exists=True)],
    as_json: Annotated[bool, Option("--json", "Print one JSON object instead of TOML.")] = False,
) -> None:
    """Find a vehicle's response to velocity set-points, and the noise of its measurements, in flight LOGs.

    The command prints the sections of a configuration; several flights, of several vehicles, give their
    spread.

    Exit status: 0 found, 2 wrong input or flights without enough excitation; the text says what to fly.
    """
    from logs import identified
    from logs.reader.flight import load_fleet

    flights = [flight for path in logs for flight in load_fleet(path).flights.values()]
    found = identified.gather(flights)
    if as_json:
        click.echo(json.dumps(found.as_json()))
    else:
        click.echo(identified.toml(found, len(flights)), nl=False)


@click.command()
@arguments
def record(
    socket_path: Annotated[
        Path, Option("--socket", "Socket to listen on; the other commands take it as --recorder.")
    ],
    out: Annotated[Path, Option("--out", "MCAP file to write.", path="file")],
    until_clients: Annotated[int | None, Option(
        "--until-clients", "End when this number of clients have disconnected.", span=(1, None)
    )] = None,
) -> None:  # fmt: skip
    """Record the data that the other processes send, until Ctrl-C; the log is readable at any time."""
    from logs.recorder.recorder import record_main

    sys.exit(record_main(socket_path, out, until_clients))


@click.command()
@arguments
def report(
    log: Annotated[Path, Option("LOG", exists=True)],
    out: Annotated[Path | None, Option(
        "--out", "HTML file; default: next to the log, report.html for flight.mcap.", path="file"
    )] = None,
    as_json: JsonVerdict = False,
) -> None:  # fmt: skip
    """Write the report of a LOG: one self-contained HTML page with all its vehicles.

    The command prints the verdict on the LOG and the path of the page. Exit status: 0 written, 2 wrong input.
    """
    from logs.report.report import write_report
    from logs.verdict.verdict import judged, result

    fleet, verdict = judged(log)
    values = result(fleet, verdict, write_report(fleet, verdict, out))
    show_verdict(values, as_json=as_json)
    if not as_json:
        click.echo(plain(values["report"]))


@click.command()
@arguments
def view(
    log_file: Log,
    save: Annotated[Path | None, Option(
        "--save", "Write a Rerun recording instead of opening a window.", "FILE.rrd", path="file"
    )] = None,
    web: Annotated[
        bool, Option("--web", "Serve Rerun to a browser of this machine, instead of opening a window.")
    ] = False,
    force: Force = False,
) -> None:  # fmt: skip
    """Show a LOG in Rerun: the scene in 3-D, curves and events (docs/how_to/viewing.md).

    A fleet is shown in one scene.

    The command needs the extra `view`. Exit status: 0 shown or written, 1 shown or written from a broken
    LOG, 2 wrong input or no window.
    """
    from logs.view.view import open_viewer
    from logs.view.view import save as saved

    def written(recording: Path) -> str:
        problem = saved(log_file, recording)
        if problem:
            text = f"flightstack: the log is broken; what can be read is shown: {problem}"
            click.echo(plain(text), err=True)
        return problem

    if save is not None:
        with new_file(save, force=force) as part:
            problem = written(part)
        click.echo(plain(f"{save}: open it with `rerun {save}`"))
    else:
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / f"{log_file.stem}.rrd"
            problem = written(recording)
            if open_viewer(recording, web=web):
                raise ValueError(
                    "Rerun did not open; without a display use --web, or --save and another machine"
                )
    sys.exit(BROKEN if problem else DONE)


EQUAL, DIFFERENT, UNUSABLE = 0, 1, 2
_STATUS = {"unusable": UNUSABLE, "different": DIFFERENT, "equal": EQUAL}  # exit status by result, worst first


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    log: Annotated[Path, Option("LOG", exists=True)]
    check: Annotated[bool, Option("--check", "Compare bit by bit; this is also the default.")] = False
    settings: Annotated[tuple[str, ...], Option(
        "--set",
        "Show what another configuration would have commanded, e.g. barrier.alpha_1_m=1.2; repeatable.",
        "KEY=VALUE"
    )] = ()  # fmt: skip
    filter: Annotated[str | None, shared.safety_filter(
        "Filter of the log, if it has to be imported from the working folder"
    )] = None  # fmt: skip
    member: shared.Member = None
    as_json: shared.AsJson = False


@click.command()
@takes(ReplayOptions)
def replay(options: ReplayOptions) -> None:
    """Run the inputs of a LOG through today's controller and compare every decision with the recorded one.

    For a fleet, each member is compared alone, or only the one of --member.

    Exit status: 0 equal (or shown, with --set alone), 1 different, 2 the log is not usable.
    """
    from logs.reader.reader import LogError, LogFile
    from logs.replay.replay import ReplayError

    members: tuple[str, ...] = (options.member or "",)
    with suppress(LogError):  # an unreadable log is reported below
        members = LogFile(options.log, options.member).members
    found, refused = {}, []
    for member in members:
        found[member], lines = _one(options, member or None)
        if reason := found[member].get("reason"):
            refused.append(": ".join(filter(None, (member, reason))))
        elif not options.as_json:
            click.echo(plain("\n".join(f"{member}: {line}" for line in lines)))
    results = [values["result"] for values in found.values()]
    worst = next(word for word in _STATUS if word in results)
    if options.as_json:
        first = next(values for values in found.values() if values["result"] == worst)
        click.echo(json.dumps({**first, "members": found}))
    if refused:
        raise ReplayError("; ".join(refused))
    shown_only = options.settings and not options.check
    sys.exit(EQUAL if shown_only and worst == "different" else _STATUS[worst])


def _one(options: ReplayOptions, member: str | None) -> tuple[dict[str, Any], list[str]]:
    """Replay one flight; return the object of ``--json`` and the lines for the operator."""
    from flightstack.verify.certificate import problems
    from logs.replay.read import changed
    from logs.replay.replay import FlightInputs, ReplayError
    from logs.replay.replay import replay as run

    log, settings = options.log, options.settings
    try:
        table = FlightInputs(log, member).table
        if options.filter not in (None, table["filter"]):
            raise ReplayError(f"{log}: --filter {options.filter}, but the log's filter is {table['filter']}")
        config = changed(table, settings) if settings else None
        result = run(log, config, member)
    except ReplayError as error:
        return {"result": "unusable", "path": str(log), "reason": str(error)}, []
    except ConfigError as error:
        if options.filter is not None or table["filter"] in FILTERS:
            raise
        hint = f"a log starts no code of the working folder; to start it, add --filter {table['filter']}"
        raise ConfigError(f"{error}; {hint}") from error
    if config is not None:
        result.notes += [f"settings refused before take-off: {text}" for text in problems(config)]
    word = "equal" if result.equal else "different"
    values = {"result": word, "set": list(settings), **asdict(result), "path": str(result.path)}
    return values, [*_lines(result, settings), word]


def _lines(result: Result, settings: Sequence[str]) -> Iterator[str]:
    yield f"replayed {result.compared} ticks in {result.wall_s:.2f} s"
    if settings:
        yield f"with {', '.join(settings)}; vehicle and target move as recorded:"
        if result.command_first is None:
            yield "  every set-point is the same"
        else:
            yield (
                f"  the set-point differs in {result.command_ticks} of {result.compared} ticks, first in "
                f"tick {result.command_first}, at most by {result.command_most_m_s:.3g} m/s"
            )
        phases = {"recorded": result.phases_recorded, "replayed": result.phases_replayed}
        for name, changes in phases.items():
            yield f"  phases {name}: {', '.join(f'{each.phase} from {each.tick}' for each in changes)}"
    compared = {"decisions and events": result.outputs}
    if not settings:
        compared |= {"state": result.states} | ({"wire": result.wire} if result.wire is not None else {})
    for name, tally in compared.items():
        yield f"{name}: {tally.count} differences in {tally.ticks} ticks" if tally.count else f"{name}: equal"
        if not settings:
            yield from (f"  {each}" for each in tally.first)
            if tally.count > len(tally.first):
                yield f"  ... and {tally.count - len(tally.first)} more"
    yield from (f"note: {note}" for note in result.notes)
