"""The result of a fleet's flight: judges its log by member, writes the report, prints it or JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from flightstack.launch import fleet
from flightstack.launch.fleet import FleetFlown
from flightstack.launch.result import fleet_table
from flightstack.launch.run_options import RunOptions
from flightstack.launch.sitl import Flight
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Fleet
from logs.reader.reader import LogError
from logs.report.report import ReportError, write_report
from logs.verdict.types import Outcome
from logs.verdict.verdict import FleetVerdict, fleet_result, judge_fleet

_UNKNOWN = (
    "outcome", "violation", "vehicles", "ellipsoid_violations", "ellipsoid_min", "distance_min_m",
    "collisions", "realtime_factor", "report",
)  # fmt: skip


def conclude_fleet(flown: FleetFlown, console: Console, *, as_json: bool, with_report: bool) -> int:
    """Judge a flight of a fleet, write its report, print the result.

    Returns:
        Exit status: 0 all landed, 1 anything else.
    """
    values = values_of(flown, with_report=with_report)
    if as_json:
        print(json.dumps(values))
    elif values["vehicles"] is not None:
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
    """Judge a flight of a fleet and write its report; the keys of ``--json``, ``None``: not known."""
    try:
        log = load_fleet(flown.log)
    except LogError as error:
        print(f"flightstack: no result: {flown.problem or ''} {error}", file=sys.stderr)
        log_path = str(flown.log) if flown.log.exists() else None
        said = "; ".join(f"{each.name}: {each.last_line}" for each in flown.flights)
        return {**flown.about, **dict.fromkeys(_UNKNOWN), "reason": said, "log": log_path}
    verdict = judge_fleet(log)
    pages = _written(flown, log, verdict) if with_report else None
    return fleet_result(log, verdict, pages, flown.about, _factor(log, flown.wall_s))


def _written(flown: FleetFlown, log: Fleet, verdict: FleetVerdict) -> dict[str, Path] | None:
    try:
        return write_report(log, verdict, flown.folder / "report.html")
    except ReportError as error:  # the flight counts all the same
        print(f"flightstack: {error}", file=sys.stderr)
        return None


def _factor(log: Fleet, wall_s: float) -> float | None:
    """Stack time over wall time, by the longest flight."""
    times = [flight.steps.t_s for flight in log.flights.values() if flight.steps is not None]
    return max(float(t_s[-1] - t_s[0]) for t_s in times) / wall_s if times and wall_s > 0.0 else None


def _landed(values: Mapping[str, object], flown: FleetFlown) -> bool:
    """Whether all vehicles landed and no process failed."""
    return values["outcome"] == Outcome.LANDED.value and flown.problem is None


def _print(console: Console, values: Mapping[str, Any]) -> None:
    reasons = "\n".join(f"{name}: {vehicle['reason']}" for name, vehicle in values["vehicles"].items())
    console.print(fleet_table(values, reasons))
    console.print(f"log     {values['log']}", soft_wrap=True)
    if values["report"] is not None:
        console.print(f"report  {values['report']}", soft_wrap=True)
