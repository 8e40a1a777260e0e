"""Command ``watch``: shows a flight on this or another machine in the terminal, in 3-D or as JSON."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from flightstack.common.hangup import Stop
from flightstack.common.options import takes
from flightstack.common.streams import reader_gone
from flightstack.common.text import without_rerun
from flightstack.config.options import WATCHED, WatchOptions

if TYPE_CHECKING:
    from flightstack.watch import Watch

FRESH, NOTHING = 0, 1
LOOK_S = 0.05  # time between two polls of --once, s
DRAW_S = 0.1  # time between two updates of the 3-D view, s
PRINT_S = 0.5  # time between two lines of JSON, s
NICER = 10  # niceness of a 3-D view: the flight's processes have priority


@click.command()
@takes(WatchOptions)
def watch(options: WatchOptions) -> None:
    """Show a running flight: phase, h, set-points, ages, battery, loop timing. Ctrl-C ends it.

    The command only receives data. Exit status: 0 normal end, 1 no recent data with --once, 2 wrong input.
    """
    from bridge.zenoh import zenoh_link
    from flightstack.watch import Watch

    if options.view is not None and (options.once or options.as_json):
        raise click.UsageError("--view draws until it is ended; --once and --json print: give one of them")
    draw = _view(options, options.view) if options.view is not None else None
    stop = Stop().install()
    connect = options.connect or ((WATCHED,) if options.zenoh_config is None else ())
    session = zenoh_link.open_session([], connect, config_file=options.zenoh_config)
    try:
        role, dialled = zenoh_link.dialled(connect, config_file=options.zenoh_config)
        flight = Watch(session, options.namespace, role=role)
        if options.once:
            sys.exit(_once(options, flight, ", ".join(dialled), stop))
        elif draw is not None:
            draw(flight, stop)
        elif options.as_json:
            _print(flight, stop)
        else:
            _live(flight, options.namespace, ", ".join(dialled), stop)
    finally:
        session.close()


def _once(options: WatchOptions, flight: Watch, endpoint: str, stop: Stop) -> int:
    from flightstack.common.terminal import Terminal
    from flightstack.watch import News, draw, snapshot

    until_s = time.monotonic() + options.timeout_s
    while not (flight.news is News.FRESH and flight.health is not None) and time.monotonic() < until_s:
        if stop.is_set:
            break
        time.sleep(LOOK_S)
        flight.poll()
    if options.as_json:
        click.echo(json.dumps(snapshot(flight)))
    else:
        Terminal().print(draw(flight, options.namespace, endpoint))
    return FRESH if flight.news is News.FRESH else NOTHING


def _print(flight: Watch, stop: Stop) -> None:
    from flightstack.watch import snapshot

    while not stop.is_set and not reader_gone():
        time.sleep(PRINT_S)
        flight.poll()
        click.echo(json.dumps(snapshot(flight)))


def _live(flight: Watch, namespace: str, endpoint: str, stop: Stop) -> None:
    from flightstack.common.terminal import Terminal
    from flightstack.watch import REFRESH_HZ, LiveView

    view = LiveView({namespace: flight}, f"{namespace} at {endpoint}", Terminal(), endpoint)
    with view.live:
        while not stop.is_set:
            time.sleep(1.0 / REFRESH_HZ)
            view.poll()


def _view(options: WatchOptions, where: str) -> Callable[[Watch, Stop], None]:
    """Open the 3-D view; return the function that draws a flight until the user ends it.

    Raises ConfigError: the configuration is wrong; ValueError: Rerun is not installed, or the output file is
    not allowed.
    """
    from flightstack.config import load
    from logs.reader.flight_data import shape

    try:
        from logs.view.live import LiveRecording
    except ModuleNotFoundError as error:
        raise without_rerun(error, "--view") from error
    run = {"namespace": options.namespace}
    if options.config_file is not None:
        run |= shape(load(options.config_file))
    else:
        click.echo(
            "flightstack: without --config there is no barrier, and the pad is drawn in a Crazyflie's size",
            err=True,
        )
    os.nice(NICER)  # the viewer that Rerun starts inherits this niceness
    recording = LiveRecording(where, run, options.namespace)
    click.echo(f"ready {recording.address}")

    def draw(flight: Watch, stop: Stop) -> None:
        try:
            while not stop.is_set and not recording.closed:
                time.sleep(DRAW_S)
                flight.poll()
                recording.add(
                    flight.new_steps, flight.new_timings, flight.health.reason if flight.health else ""
                )
        finally:
            recording.close()

    return draw
