"""Compares the simulator with each flight of a folder, in worker processes, and makes the page of the result.

A flight that cannot be read or used is listed with its reasons and not compared. The page is one HTML file,
without links, of criteria, left-out flights and figures.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

from flightstack.common.pool import in_processes
from logs.report.page import Page, Panel, details, html, need_libraries, paragraph, table
from sim.flights.recording import COLUMNS, Group, RecordingError, read_columns
from sim.flights.screening import Reason, load
from sim.options import ValidateOptions
from sim.plant.params import Params
from sim.plant.params import load as load_vehicle
from sim.validation import closed_loop, open_loop, sensing
from sim.validation.closed_loop import ClosedLoop
from sim.validation.open_loop import OpenLoop
from sim.validation.sensing import Sensing

VEHICLE = "crazyflie21_room"  # vehicle of the recorded flights with which the project was compared


@dataclass(frozen=True)
class Compared:
    """Comparison of one flight with the simulator."""

    name: str  # name of the file without suffix
    used_s: float  # compared time; 0 if the flight is left out
    left_out: tuple[Reason, ...]  # unused parts, or the whole flight, with the reasons
    # Results; None: the flight is left out or lacks the required columns.
    open_loop: OpenLoop | None = None
    closed_loop: ClosedLoop | None = None
    sensing: Sensing | None = None
    shuffled: OpenLoop | None = None  # open loop with the motor commands in random order

    @property
    def used(self) -> bool:
        return self.used_s > 0.0


def compare(path: Path, columns: dict[str, Group], params: Params, options: ValidateOptions) -> Compared:
    """Compare one flight; the random numbers depend only on the flight's name and the seed."""
    try:
        flight = load(path, columns)
    except RecordingError as error:
        return Compared(path.stem, 0.0, (Reason(str(error), 0.0),))
    if not flight.usable:
        return Compared(path.stem, 0.0, flight.left_out)
    seed = options.seed + crc32(path.stem.encode())
    return Compared(
        path.stem,
        flight.seconds,
        flight.left_out,
        open_loop.compare(flight, params),
        closed_loop.fly(flight, params, seed),
        sensing.compare(flight, seed),
        open_loop.compare(flight, params, shuffle_seed=seed + 1),
    )


def run(
    options: ValidateOptions, paths: Sequence[Path], workers: int, on_flight: Callable[[Compared], None]
) -> list[Compared]:
    """Compare flights in ``workers`` processes; the result is sorted by name.

    ``on_flight``: called with each compared flight, in any order.
    Raises RecordingError: the table of columns is wrong; ConfigError: the vehicle's file is wrong;
    WorkersError: no process starts.
    """
    columns, params = read_columns(options.columns or COLUMNS), load_vehicle(options.vehicle or VEHICLE)
    work = partial(compare, columns=columns, params=params, options=options)
    alone = workers == 1 or len(paths) <= 1
    done: list[Compared] = []
    for one in map(work, paths) if alone else in_processes(work, paths, workers, _failed):
        on_flight(one)
        done.append(one)
    return sorted(done, key=lambda one: one.name)


def _failed(path: Path, why: str) -> Compared:
    return Compared(path.stem, 0.0, (Reason(why, 0.0),))


Summary = dict[str, Any]

_CRITERIA = (
    "Ratios of rms errors unless stated otherwise. Found: over flights, with an interval of 95 % by "
    "bootstrap over flights. Open: outside the limit, but chance explains it, or no flight covers it."
)
_OPEN_LOOP = (
    "Started every 0.1 s from the recorded state, with the recorded motor commands and voltage. "
    "Bars: median over flights of the rms error in a flight; lines on them: 95 % interval."
)
_CLOSED_LOOP = (
    "Each flight, flown again by the simulated firmware from the recorded set-points. On the line "
    "simulation and recording agree; dashed: the limits of the criteria."
)
_FLIGHTS = (
    "Open loop: error of position after 0.1 / 0.25 / 0.5 s. Tracking (level) and delay of the estimated "
    "position: recorded / simulated."
)
_SENSING = (
    "Error of the estimated vehicle state along the same true path, recorded and simulated, without its "
    "constant delay and offset. Lines on the bars: 95 % interval."
)


def validation_page(summary: Summary) -> Page:
    """Return the page of a ``summary``. Raises ReportError: the plotting or template library is missing."""
    need_libraries()
    from sim.validation import figures  # a late import, because the module needs plotly

    rows = [
        (one["part"], one["text"], one["limit"], one["found"], one["word"], one["reason"])
        for one in summary["criteria"]
    ]  # fmt: skip
    numbers = json.dumps({key: value for key, value in summary.items() if key != "by_flight"}, indent=1)
    head = ("part", "criterion", "limit", "found", "", "reason of the limit")
    met = sum(one["met"] for one in summary["criteria"])
    causes = html("".join(map(paragraph, summary["causes"])))
    return Page(
        f"{summary['vehicle']} beside recorded flights",
        ("passed", "good") if summary["passed"] else ("not passed", "bad"),
        summary["folder"],
        [
            ("criteria met", f"{met} of {len(rows)}", ""),
            ("flights compared", f"{summary['used']} of {summary['flights']}", ""),
            ("time compared", f"{summary['used_s']:.0f}", "s"),
            ("flights left out in part", str(len(summary["cut"])), ""),
        ],
        [
            Panel("open_loop", "Open loop", _OPEN_LOOP, figures.open_loop(summary)),
            *([Panel("causes", "Why it did not pass", "", causes)] if summary["causes"] else []),
            Panel("criteria", "Criteria", _CRITERIA, table(head, rows, numbers=(2, 3), row_class=4)),
            Panel("left_out", "Left out", "What was not compared, and why.", _left_out(summary)),
            Panel("closed_loop", "Closed loop", _CLOSED_LOOP, figures.closed_loop(summary)),
            Panel("sensing", "Vehicle state", _SENSING, figures.sensing(summary)),
            Panel("flights", "Flights", _FLIGHTS, _flights(summary)),
            Panel("json", "", "", details("Everything as JSON", numbers, "validate.json")),
        ],
    )  # fmt: skip


def _left_out(summary: Summary) -> str:
    rows = [
        (each["name"], what, "; ".join(each["reasons"]))
        for key, what in (("left_out", "whole"), ("cut", "parts"))
        for each in summary[key]
    ]
    return table(("flight", "what", "reasons"), rows) if rows else "Nothing."


def _flights(summary: Summary) -> str:
    def both(sides: Summary | None, *path: str) -> str:
        """Return the text "recorded / simulated" of two values, in mm or ms."""
        if not sides:
            return " / "
        values = []
        for side in ("recorded", "simulated"):
            value: Any = sides[side]
            for key in path:
                value = value[key]
            values.append("" if value is None else f"{1000.0 * value:.0f}")
        return " / ".join(values)

    rows = []
    for one in summary["by_flight"]:
        errors = [h["position_m"]["model"] for h in (one["open_loop"] or {}).get("horizons", [])]
        mm = " / ".join("" if error is None else f"{1000.0 * error:.0f}" for error in errors)
        closed, sensed = one["closed_loop"], one["sensing"]
        rows.append((one["name"], f"{one['used_s']:.1f}", mm, both(closed, "horizontal_m"),
                     both(sensed, "position", "delay_s")))  # fmt: skip
    head = ("flight", "used [s]", "open loop [mm]", "tracking [mm]", "delay [ms]")
    return table(head, rows, numbers=(1, 2, 3, 4))
