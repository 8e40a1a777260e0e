"""Commands that record, replay and show flight logs, write reports, and identify a vehicle."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from flightstack.cli.log import BROKEN, DONE, Force, JsonVerdict, Log, new_file, show_verdict
from flightstack.common.options import Option, arguments, takes
from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import labels, named, outline, plain
from flightstack.config import options as shared
from flightstack.core.parameters.filters import FILTERS

if TYPE_CHECKING:
    from logs.compare import Tally
    from logs.replay.replay import PhaseChange, Result


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
    """Write the report of a LOG: one self-contained HTML page.

    A fleet has one page for all members together, and one page for each member.

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
    from logs.view.view import Recording, open_viewer

    recording = Recording(log_file)
    if save is not None:
        with new_file(save, force=force) as part:
            recording.save(part)
        click.echo(plain(f"{save}: open it with `rerun {save}`"))
    if problem := recording.problem:
        click.echo(plain(f"flightstack: the log is broken; what can be read is shown: {problem}"), err=True)
    if save is None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{log_file.stem}.rrd"
            recording.save(file)
            if open_viewer(file, web=web):
                raise ValueError(
                    "Rerun did not open; without a display use --web, or --save and another machine"
                )
    sys.exit(BROKEN if problem else DONE)


EQUAL, DIFFERENT, UNUSABLE = 0, 1, 2
_STATUS = {"unusable": UNUSABLE, "different": DIFFERENT, "equal": EQUAL}  # exit statuses, the worst first


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
    from logs.replay.replay import ReplayError

    members = _members(options.log) if options.member is None else (options.member,)
    found, refused = {}, []
    for member, label in zip(members, labels(members), strict=True):
        found[member], lines = _one(options, member or None)
        if reason := found[member].get("reason"):
            refused.append(named(label, reason))
        elif not options.as_json:
            click.echo(plain("\n".join(named(label, line) for line in lines)))
    results = [values["result"] for values in found.values()]
    worst = next(word for word in _STATUS if word in results)
    if options.as_json:
        whole = {"result": worst, "path": str(options.log), "set": list(options.settings)}
        click.echo(json.dumps(outline(whole, "members", found)))
    elif len(members) > 1:
        click.echo(f"{worst}: {len(members)} members")
    if refused:
        raise ReplayError("; ".join(refused))
    shown_only = options.settings and not options.check
    sys.exit(EQUAL if shown_only and worst == "different" else _STATUS[worst])


def _members(log: Path) -> tuple[str, ...]:
    """Return the names of the members in a log; one empty name if it cannot be read."""
    from logs.reader.reader import LogError, LogFile

    try:
        return LogFile(log).members
    except LogError:
        return ("",)


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
    return values, _lines(result, settings)


def _lines(result: Result, settings: Sequence[str]) -> list[str]:
    lines = [f"replayed {result.compared} ticks in {result.wall_s:.2f} s"]
    if settings:
        lines += _what_if(result, settings)
    lines += _tally("decisions and events", result.outputs, shown=not settings)
    if not settings:
        lines += _tally("state", result.states)
        lines += _tally("wire", result.wire) if result.wire is not None else []
    lines += [f"note: {note}" for note in result.notes]
    return [*lines, "equal" if result.equal else "different"]


def _tally(name: str, tally: Tally, *, shown: bool = True) -> list[str]:
    if not tally.count:
        return [f"{name}: equal"]
    lines = [f"{name}: {tally.count} differences in {tally.ticks} ticks"]
    if shown:
        lines += [f"  {each}" for each in tally.first]
        if tally.count > len(tally.first):
            lines.append(f"  ... and {tally.count - len(tally.first)} more")
    return lines


def _what_if(result: Result, settings: Sequence[str]) -> list[str]:
    lines = [f"with {', '.join(settings)}; vehicle and target move as recorded:"]
    if result.command_first is None:
        lines.append("  every set-point is the same")
    else:
        lines.append(
            f"  the set-point differs in {result.command_ticks} of {result.compared} ticks, first in tick "
            f"{result.command_first}, at most by {result.command_most_m_s:.3g} m/s"
        )
    lines.append(f"  phases recorded: {_phases(result.phases_recorded)}")
    lines.append(f"  phases replayed: {_phases(result.phases_replayed)}")
    return lines


def _phases(changes: Sequence[PhaseChange]) -> str:
    return ", ".join(f"{change.phase} from {change.tick}" for change in changes)
