"""The verb ``replay``: compares today's decisions with a log, tries other settings, or plays a log."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from logs.replay.compare import Tally
    from logs.replay.replay import PhaseChange, Result

EQUAL, DIFFERENT, UNUSABLE = 0, 1, 2


@click.command()
@click.argument("log", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--check", is_flag=True, help="Compare bit by bit; this is also the default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Show what another configuration would have commanded, e.g. barrier.alpha_1_m=1.2; repeatable.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@click.option("--live", is_flag=True, help="Send the recorded messages of target and vehicle again.")
@click.option(
    "--vehicle-url",
    metavar="URL",
    help="MAVLink URL of the played vehicle: udpin:HOST:PORT, udpout:HOST:PORT.",
)
@click.option(
    "--target-key", metavar="KEY", help="Zenoh key of the target's odometry; default: the recorded key."
)
@click.option(
    "--connect", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint to connect to; repeatable."
)
@click.option("--listen", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint to listen on; repeatable.")
@click.option("--view", is_flag=True, help="Also publish the recorded decisions, for viewers.")
@click.option(
    "--rate",
    type=click.FloatRange(min=0.01, max=100.0),
    default=1.0,
    show_default=True,
    help="Seconds of the log played in a second; below 1 the stack refuses the target's samples as late.",
)
@click.option(
    "--start",
    "start_s",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="S",
    help="Begin this time after the start of the log.",
)
@click.option("--loop", is_flag=True, help="Begin again at the end, until Ctrl-C or --duration.")
@click.option("--pause", is_flag=True, help="Begin paused. Keys: space or Enter continue, s plays one tick.")
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0.0),
    default=10.0,
    show_default=True,
    metavar="S",
    help="Longest wait for a receiver; 0: do not wait.",
)
@click.option(
    "--duration", "duration_s", type=click.FloatRange(min=0.1), metavar="S", help="End after S seconds."
)
@click.option(
    "--signing-key", type=click.Path(path_type=Path), metavar="FILE", help="Sign the vehicle's frames."
)
@click.option("--allow-unsigned", is_flag=True, help="Play the vehicle on a network without a key.")
def replay(
    log: Path, check: bool, settings: tuple[str, ...], as_json: bool, live: bool, **where: Any
) -> None:  # fmt: skip
    """Run the inputs of a LOG through today's controller and compare every decision with the recorded one.

    Exit status: 0 equal (or shown, with --set alone), 1 different, 2 the log proves nothing.
    """
    from flightstack.verify.certificate import problems
    from logs.replay.read import changed
    from logs.replay.replay import FlightInputs, ReplayError
    from logs.replay.replay import replay as run

    if live:
        if check or settings or as_json:
            raise click.UsageError("--live plays a log; it cannot be combined with --check, --set and --json")
        _live(log, where)
        return
    try:
        config = changed(FlightInputs(log).table, settings) if settings else None
        result = run(log, config)
    except ReplayError as error:
        if as_json:
            click.echo(json.dumps({"result": "unusable", "path": str(log), "reason": str(error)}))
        raise
    if config is not None:
        result.notes += [f"it would be refused before take-off: {text}" for text in problems(config)]
    if as_json:
        click.echo(json.dumps(_object(result, settings)))
    else:
        click.echo("\n".join(_lines(result, settings)))
    sys.exit(DIFFERENT if not result.equal and (check or not settings) else EQUAL)


def _live(log: Path, where: dict[str, Any]) -> None:
    from logs.replay.live import LiveOptions, play

    ticks = play(log, LiveOptions(**where), say=click.echo)
    click.echo(f"played {ticks} ticks")


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
