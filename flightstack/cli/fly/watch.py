"""The verb ``watch``: shows a flight of this or another machine, in the terminal, in 3-D or as JSON."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NamedTuple

import click

from flightstack.cli.options import takes, without_rerun
from flightstack.common.streams import reader_gone
from flightstack.watch.options import DEFAULT, WatchOptions

if TYPE_CHECKING:
    from bridge.zenoh.zenoh_link import Role, Session
    from flightstack.watch.state import Watch

FRESH, NOTHING = 0, 1
LOOK_S = 0.05  # between two looks
DRAW_S = 0.1  # between two pieces of the view in 3-D
NICER = 10  # niceness of a view in 3-D: the flight's processes go first


@click.command()
@takes(WatchOptions)
def watch(options: WatchOptions) -> None:
    """Show a flight while it flies: phase, h, set-points, ages, battery, loop timing. Ctrl-C ends it.

    It only listens. Exit status: 0 normal end, 1 no fresh data with --once, 2 wrong input.
    """
    from bridge.zenoh import zenoh_link

    if options.view is not None and (options.once or options.as_json):
        raise click.UsageError("--view draws until it is ended; --once and --json print: give one of them")
    draws = (
        _drawing(options.view, options.config_file, options.namespace) if options.view is not None else None
    )
    ended = Ended()
    previous = {number: signal.signal(number, ended.end) for number in (signal.SIGINT, signal.SIGTERM)}
    connect = options.connect or ((DEFAULT,) if options.zenoh_config is None else ())
    session = zenoh_link.open_session([], connect, config_file=options.zenoh_config)
    role, whom = zenoh_link.dialled(connect, config_file=options.zenoh_config)
    source = Source(session, role, ", ".join(whom), options.namespace, ended)
    try:
        if options.once:
            sys.exit(_once(source, options.as_json, options.timeout_s))
        draws(source) if draws else _stream(source) if options.as_json else _live(source)
    finally:
        session.close()
        for number, handler in previous.items():
            signal.signal(number, handler)


class Ended:
    """Whether SIGINT or SIGTERM came; a shell's background job ignores SIGINT by default, this does not."""

    def __init__(self) -> None:
        self.yes = False

    def end(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal."""
        del number, frame
        self.yes = True


class Source(NamedTuple):
    """The Zenoh session through which the flight is watched."""

    session: Session
    role: Role
    whom: str
    namespace: str
    ended: Ended

    def watch(self) -> Watch:
        """Subscribe to the flight's keys."""
        from flightstack.watch.state import Watch

        return Watch(self.session, self.namespace, role=self.role)


def _once(source: Source, as_json: bool, timeout_s: float) -> int:
    from flightstack.common.terminal import Terminal
    from flightstack.watch.live import draw
    from flightstack.watch.state import News, snapshot

    seen = source.watch()
    until_s = time.monotonic() + timeout_s
    while not (seen.news is News.FRESH and seen.health is not None) and time.monotonic() < until_s:
        if source.ended.yes:
            break
        time.sleep(LOOK_S)
        seen.poll()
    if as_json:
        click.echo(json.dumps(snapshot(seen)))
    else:
        Terminal().print(draw(seen, source.namespace, source.whom))
    return FRESH if seen.news is News.FRESH else NOTHING


def _stream(source: Source) -> None:
    from flightstack.watch.state import snapshot

    seen = source.watch()
    while not source.ended.yes:
        time.sleep(0.5)
        seen.poll()
        click.echo(json.dumps(snapshot(seen)))
        if reader_gone():
            return


def _drawing(view: str, config_file: Path | None, namespace: str) -> Callable[[Source], None]:
    """Open the view, and return the function that draws in it until the user ends it.

    Raises:
        ConfigError: the configuration is wrong.
        ValueError: Rerun is not installed, or the file to write is not allowed.
    """
    from flightstack.config.files import load
    from logs.reader.flight_data import shape

    try:
        from logs.view.live import LiveRecording
    except ModuleNotFoundError as error:
        raise without_rerun(error, "--view") from error
    run = {"namespace": namespace}
    if config_file is not None:
        run |= shape(load(config_file))
    else:
        click.echo(
            "flightstack: without --config there is no barrier, and the pad is drawn in a Crazyflie's size",
            err=True,
        )
    os.nice(NICER)  # the viewer that Rerun starts inherits it
    recording = LiveRecording(view, run, namespace)
    click.echo(f"ready {recording.address}")

    def draw(source: Source) -> None:
        seen = source.watch()
        try:
            while not source.ended.yes and not recording.closed:
                time.sleep(DRAW_S)
                seen.poll()
                recording.add(seen.new_steps, seen.new_timings, seen.health.reason if seen.health else "")
        finally:
            recording.close()

    return draw


def _live(source: Source) -> None:
    from flightstack.common.terminal import Terminal
    from flightstack.watch.live import REFRESH_HZ, LiveView

    title = f"{source.namespace} at {source.whom}"
    view = LiveView(source.session, source.namespace, title, Terminal(), source.whom, source.role)
    with view.live:
        while not source.ended.yes:
            time.sleep(1.0 / REFRESH_HZ)
            view.poll()
