"""The result of a fleet's flight: judges its log by member, writes the report, prints it or JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from flightstack.launch import fleet
from flightstack.launch.fleet import FleetFlown
from flightstack.launch.run_options import RunOptions
from flightstack.launch.sitl import Flight, shown
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Fleet
from logs.reader.reader import LogError
from logs.verdict.fleet import fleet_result, judge_fleet
from logs.verdict.types import Outcome

_COLUMNS = (
    ("outcome", "outcome"),
    ("violation", "violation"),
    ("error, m", "touchdown_error_m"),
    ("speed down, m/s", "touchdown_speed_vertical_m_s"),
    ("lowest h outside the pad, m", "h_min_outside_pad_m"),
    ("time, s", "time_to_land_s"),
)
_ALL = ("outcome", "violation", "collisions", "ellipsoid_violations", "ellipsoid_min", "distance_min_m",
        "realtime_factor")  # fmt: skip


def conclude_fleet(flown: FleetFlown, console: Console, *, as_json: bool, with_report: bool) -> int:
    """Judge a flight of a fleet, write its report, print the result.

    Returns:
        Exit status: 0 all landed, 1 anything else.
    """
    values = values_of(flown, with_report=with_report)
    if as_json:
        print(json.dumps(values))
    else:
        _print(console, values)
    if flown.problem:
        print(f"flightstack: {flown.problem}", file=sys.stderr)
    return 0 if _landed(values, flown) else 1


def fly_fleet(options: RunOptions, console: Console, *, with_report: bool) -> Flight:
    """Fly a team and judge it.

    Raises:
        ConfigError: wrong input.
        LaunchError: a process did not start.
    """
    flown = fleet.run(options, console)
    values = values_of(flown, with_report=with_report)
    return Flight(values, _landed(values, flown), flown.problem, flown.interrupted)


def values_of(flown: FleetFlown, *, with_report: bool) -> dict[str, Any]:
    """Judge a flight of a fleet; the keys of ``--json``, ``None`` for what is not known."""
    try:
        log = load_fleet(flown.log)
    except LogError as error:
        print(f"flightstack: no result: {flown.problem or ''} {error}", file=sys.stderr)
        lines = "; ".join(f"{each.name}: {each.last_line}" for each in flown.flights)
        unknown = dict.fromkeys(("outcome", "violation", "vehicles", *_ALL[2:]))
        return {**flown.about, **unknown, "reason": lines, "log": str(flown.log), "report": None}
    report = None
    del with_report
    return fleet_result(log, judge_fleet(log), report, flown.about, _factor(log, flown.wall_s))


def _factor(log: Fleet, wall_s: float) -> float | None:
    """Stack time over wall time, by the longest flight."""
    times = [flight.steps.t_s for flight in log.flights.values() if flight.steps is not None]
    return max(float(t_s[-1] - t_s[0]) for t_s in times) / wall_s if times and wall_s > 0.0 else None


def _landed(values: Mapping[str, object], flown: FleetFlown) -> bool:
    """Whether all vehicles landed and no process failed."""
    return values["outcome"] == Outcome.LANDED.value and flown.problem is None


def _print(console: Console, values: Mapping[str, Any]) -> None:
    right = (Column(name, justify="right") for name, _ in _COLUMNS)
    about = ", ".join(f"{name} {values[name]}" for name in ("scenario", "seed", "filter"))
    table = Table("vehicle", *right, title=about, title_justify="left")
    vehicles = values["vehicles"] or {}
    for name, vehicle in vehicles.items():
        table.add_row(name, *(shown(vehicle.get(key)) for _, key in _COLUMNS))
    console.print(table)
    for name, vehicle in vehicles.items():
        console.print(f"{name}  {vehicle['reason']}", soft_wrap=True, markup=False)
    told = "  ".join(f"{name.replace('_', ' ')} {shown(values[name])}" for name in _ALL)
    console.print(told, soft_wrap=True)
    console.print(f"log     {values['log']}", soft_wrap=True)
    if values["report"] is not None:
        console.print(f"report  {values['report']}", soft_wrap=True)
