"""The verb ``replay``: compares today's decisions with a log, or tries other settings."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from flightstack.cli.options import takes
from flightstack.common.options import Argument, Option
from flightstack.common.text import plain
from flightstack.config import options as shared

if TYPE_CHECKING:
    from logs.replay.replay import PhaseChange, Result
    from logs.tools.compare import Tally

EQUAL, DIFFERENT, UNUSABLE = 0, 1, 2
_WORST_FIRST = ("unusable", "different", "equal")


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Options of ``replay``."""

    log: Annotated[Path, Argument(path="file", exists=True)]
    check: Annotated[bool, Option("--check", "Compare bit by bit; this is also the default.")] = False
    settings: Annotated[tuple[str, ...], Option(
        "--set",
        "Show what another configuration would have commanded, e.g. barrier.alpha_1_m=1.2; repeatable.",
        "KEY=VALUE"
    )] = ()  # fmt: skip
    member: shared.Member = None
    as_json: shared.AsJson = False


@click.command()
@takes(ReplayOptions)
def replay(options: ReplayOptions) -> None:
    """Run the inputs of a LOG through today's controller and compare every decision with the recorded one.

    Of a fleet each member is compared alone, or the one of --member.

    Exit status: 0 equal (or shown, with --set alone), 1 different, 2 the log proves nothing.
    """
    from logs.replay.replay import ReplayError

    try:
        members = () if options.member is not None else _members(options.log)
        if members:
            sys.exit(_fleet(options, members))
        result = _run(options, options.member)
    except ReplayError as error:
        if options.as_json:
            click.echo(json.dumps(_unusable(options.log, error)))
        raise
    if options.as_json:
        click.echo(json.dumps(_object(result, options.settings)))
    else:
        click.echo(plain("\n".join(_lines(result, options.settings))))
    sys.exit(_status(options, result))


def _members(log: Path) -> tuple[str, ...]:
    """Members of a fleet; () for one flight."""
    from logs.reader.reader import LogError, LogFile
    from logs.replay.replay import ReplayError

    try:
        return LogFile(log).members
    except LogError as error:
        raise ReplayError(str(error)) from error


def _run(options: ReplayOptions, member: str | None) -> Result:
    """Replay one flight."""
    from flightstack.verify.certificate import problems
    from logs.replay.read import changed
    from logs.replay.replay import FlightInputs
    from logs.replay.replay import replay as run

    log, settings = options.log, options.settings
    config = changed(FlightInputs(log, member).table, settings) if settings else None
    result = run(log, config, member)
    if config is not None:
        result.notes += [f"it would be refused before take-off: {text}" for text in problems(config)]
    return result


def _status(options: ReplayOptions, result: Result) -> int:
    return DIFFERENT if not result.equal and (options.check or not options.settings) else EQUAL


def _fleet(options: ReplayOptions, members: Sequence[str]) -> int:
    """Replay each member alone and tell; the exit status of the worst."""
    from logs.replay.replay import ReplayError

    status, told = EQUAL, {}
    for member in members:
        try:
            result = _run(options, member)
        except ReplayError as error:
            status = UNUSABLE
            told[member] = _unusable(options.log, error)
            lines = [f"unusable: {error}"]
        else:
            status = max(status, _status(options, result))
            told[member] = _object(result, options.settings)
            lines = _lines(result, options.settings)
        if not options.as_json:
            click.echo(plain("\n".join(f"{member}: {line}" for line in lines)))
    results = {each["result"] for each in told.values()}
    whole = next(word for word in _WORST_FIRST if word in results)
    if options.as_json:
        whole_told = {"result": whole, "path": str(options.log), "set": list(options.settings)}
        click.echo(json.dumps({**whole_told, "members": told}))
    else:
        click.echo(f"{whole}: {len(members)} members")
    return status


def _unusable(log: Path, error: ValueError) -> dict[str, Any]:
    return {"result": "unusable", "path": str(log), "reason": str(error)}


def _object(result: Result, settings: Sequence[str]) -> dict[str, Any]:
    whole = asdict(result)
    whole["path"] = str(result.path)
    return {"result": "equal" if result.equal else "different", "set": list(settings), **whole}


def _lines(result: Result, settings: Sequence[str]) -> list[str]:
    lines = [
        f"replayed {result.compared} ticks, {result.first_tick} to {result.last_tick}, from {result.start}, "
        f"in {result.wall_s:.2f} s"
    ]
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
