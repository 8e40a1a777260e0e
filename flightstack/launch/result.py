"""The result of a flight: judges its log, writes the report, prints a table or one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.table import Column, Table
from rich.text import Text

from logs.reader.flight import load_flight
from logs.reader.flight_data import Flight
from logs.reader.reader import LogError
from logs.report.report import ReportError, write_page
from logs.verdict.types import SOURCES
from logs.verdict.verdict import Verdict, judge, verdict_result

_ABOUT = ("scenario", "seed", "config", "filter")
_ROWS = (
    ("outcome", "outcome", ""),
    ("violation", "violation", ""),
    ("lowest h", "h_min_m", "m"),
    ("lowest h outside the pad", "h_min_outside_pad_m", "m"),
    ("touchdown error", "touchdown_error_m", "m"),
    ("touchdown speed, vertical", "touchdown_speed_vertical_m_s", "m/s"),
    ("touchdown speed, horizontal", "touchdown_speed_horizontal_m_s", "m/s"),
    ("time to land", "time_to_land_s", "s"),
    ("real-time factor", "realtime_factor", ""),
)


def verdict_table(values: Mapping[str, Any], reason: str) -> Group:
    """Return the values of ``logs.verdict.verdict.verdict_result`` as a table; "-" for what is not known."""
    told = {name: values[name] for name in _ABOUT if values.get(name) is not None}
    title = ", ".join(f"{name} {value}" for name, value in told.items())
    table = Table("result", Column("value", justify="right"), "unit")
    for name, key, unit in _ROWS:
        table.add_row(name, _shown(values[key]), unit)
    source = SOURCES.get(values["judged_from"], "what the onboard process said")
    return Group(Text(title, style="italic"), table, Text(f"judged from {source}"), Text(reason))


_MEMBER_COLUMNS = (
    ("outcome", "outcome", 1.0),
    ("violation", "violation", 1.0),
    ("least h, m", "h_min_outside_pad_m", 1.0),
    ("error, cm", "touchdown_error_m", 100.0),
    ("down, m/s", "touchdown_speed_vertical_m_s", 1.0),
    ("aside, m/s", "touchdown_speed_horizontal_m_s", 1.0),
    ("time, s", "time_to_land_s", 1.0),
)
_FLEET_ROWS = (
    ("smallest distance", "distance_min_m", "m"),
    ("the same in the ellipsoid's measure, in flight", "ellipsoid_min", "1"),
    ("times inside the ellipsoid", "ellipsoid_violations", ""),
    ("pairs that collided", "collisions", ""),
    ("real-time factor", "realtime_factor", ""),
)


def fleet_table(values: Mapping[str, Any], reason: str) -> Group:
    """Return the values of ``logs.verdict.verdict.fleet_result`` as tables; "-" for what is not known.

    Of a member: the least h outside the pad, error and speeds at touchdown, time to land.
    """
    told = {name: values[name] for name in _ABOUT if values.get(name) is not None}
    title = ", ".join(f"{name} {value}" for name, value in told.items())
    table = Table("vehicle", *(Column(name, justify="right") for name, _, _ in _MEMBER_COLUMNS))
    for member, each in values["vehicles"].items():
        table.add_row(Text(member), *(_shown(each[key], factor) for _, key, factor in _MEMBER_COLUMNS))
    fleet = Table("fleet", Column("value", justify="right"), "unit")
    for name, key, unit in (("outcome", "outcome", ""), ("violation", "violation", ""), *_FLEET_ROWS):
        fleet.add_row(name, _shown(values[key]), unit)
    judged = dict.fromkeys(SOURCES.get(each["judged_from"], "") for each in values["vehicles"].values())
    return Group(
        Text(title, style="italic"), table, fleet, Text(f"judged from {', '.join(judged)}"), Text(reason)
    )


def _shown(value: object, factor: float = 1.0) -> str:
    return "-" if value is None else f"{value * factor:.3f}" if isinstance(value, float) else str(value)


_VERDICT = tuple(field.name for field in fields(Verdict))


@dataclass(frozen=True)
class Flown:
    """What remains of a flight: its log and its problems.

    Attributes:
        about: what was flown, the first keys of ``--json``.
        folder: where everything is.
        log: the flight log; None: nothing was recorded.
        wall_s: wall time from the first tick to the end.
        code: exit status of the onboard process; None if it was ended.
        last_line: the last that the onboard process said.
        problem: a process that failed.
        interrupted: whether the operator ended it.
    """

    about: Mapping[str, object]
    folder: Path
    log: Path | None
    wall_s: float
    code: int | None
    last_line: str
    problem: str | None
    interrupted: bool = False


def conclude(flown: Flown, console: Console, *, as_json: bool, with_report: bool) -> int:
    """Judge a flight, write its report, print the result.

    Returns:
        Exit status: 0 landed, 1 anything else.
    """
    values = conclude_values(flown, with_report=with_report)
    if as_json:
        print(json.dumps(values))
    else:
        problem = f"; {flown.problem}" if flown.problem else ""
        console.print(verdict_table(values, f"{values['reason']}{problem}"))
        _paths(console, values, with_report=with_report)
    if flown.problem:
        print(f"flightstack: {flown.problem}", file=sys.stderr)
    return 0 if landed(values, flown) else 1


def conclude_values(flown: Flown, *, with_report: bool) -> dict[str, object]:
    """Judge a flight and write its report; the keys of ``--json``, ``None`` for what is not known.

    Without a log the outcome is the one that the onboard process reported, and nothing is measured.
    """
    flight = _flight(flown)
    if flight is None:
        outcome = "landed" if flown.log is None and flown.code == 0 else None
        return {
            **flown.about,
            **dict.fromkeys((*_VERDICT, "realtime_factor")),
            "outcome": outcome,
            "reason": flown.last_line,
            "log": str(flown.log) if flown.log is not None and flown.log.exists() else None,
            "report": None,
        }
    verdict = judge(flight)
    report = None
    if with_report:
        try:
            report = write_page(flight, verdict, flown.folder / "report.html")
        except ReportError as error:  # the flight counts all the same
            print(f"flightstack: {error}", file=sys.stderr)
    flown_s = float(flight.steps.t_s[-1] - flight.steps.t_s[0]) if flight.steps is not None else 0.0
    factor = flown_s / flown.wall_s if flown.wall_s > 0.0 else None
    return verdict_result(flight, verdict, report, flown.about, factor)


def _flight(flown: Flown) -> Flight | None:
    """The flight in the log; a log that cannot be used is named on standard error."""
    try:
        return load_flight(flown.log) if flown.log is not None else None
    except LogError as error:
        print(f"flightstack: no result: {flown.problem or flown.last_line} {error}", file=sys.stderr)
        return None


def landed(values: Mapping[str, object], flown: Flown) -> bool:
    """Return whether the vehicle landed and no process failed."""
    return values["outcome"] == "landed" and flown.problem is None


def _paths(console: Console, values: Mapping[str, object], *, with_report: bool) -> None:
    console.print(Text(f"log     {values['log'] or 'none, as asked for'}"), soft_wrap=True)
    if with_report and values["report"] is not None:
        console.print(Text(f"report  {values['report']}"), soft_wrap=True)
