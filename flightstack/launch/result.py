"""Result of a flight: check of its log, report, and output as a table or one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console, Group
from rich.table import Column, Table
from rich.text import Text

from flightstack.common.text import MissingExtraError, failed_code
from flightstack.launch.launcher import Followed
from logs.reader.flight import load_fleet
from logs.reader.reader import EmptyLogError, LogError
from logs.report.report import ReportError, write_report
from logs.verdict.types import FALL_M_S, FALLS, PROCESS, SOURCES, Outcome, Verdict
from logs.verdict.verdict import fleet_verdict, judge_fleet, result

_ABOUT = ("scenario", "seed", "config", "filter")
# columns of the vehicles' table: heading, key of the value, factor to the heading's unit
_COLUMNS = (
    ("outcome", "outcome", 1.0),
    ("violation", "violation", 1.0),
    ("least h, m", "h_min_outside_pad_m", 1.0),
    ("error, cm", "touchdown_error_m", 100.0),
    ("down, m/s", "touchdown_speed_vertical_m_s", 1.0),
    ("aside, m/s", "touchdown_speed_horizontal_m_s", 1.0),
    ("time, s", "time_to_land_s", 1.0),
)
# values of the whole run, shown if they are known: text, key, unit
_ROWS = (
    ("smallest distance", "distance_min_m", "m"),
    ("the same in the ellipsoid's measure, in flight", "ellipsoid_min", ""),
    ("times inside the ellipsoid", "ellipsoid_violations", ""),
    ("pairs that collided", "collisions", ""),
    ("real-time factor", "realtime_factor", ""),
)


def result_table(values: Mapping[str, Any], problem: str = "") -> Group:
    """Return the values of ``logs.verdict.verdict.result`` as a table with a line for each vehicle.

    "-" is an unknown value of a vehicle; ``problem``: text to print after the reasons.
    """
    vehicles = values["vehicles"]
    columns = (Column(name, justify="right") for name, _, _ in _COLUMNS)
    table = Table("", *columns, box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for name, each in vehicles.items():
        table.add_row(Text(name), *(_shown(each[key], factor) for _, key, factor in _COLUMNS))
    run = [
        f"{name} {_shown(value)} {unit}".rstrip()
        for name, key, unit in _ROWS
        if (value := values[key]) is not None
    ]
    unobserved = ""
    if len(vehicles) > 1 and values["collisions"] is None:
        unobserved = "not all pairs of vehicles were observed to the end: a collision cannot be excluded"
    sources = dict.fromkeys(SOURCES[each["judged_from"]] for each in vehicles.values())
    fell = any(
        each["outcome"] == "landed" and (each["touchdown_speed_vertical_m_s"] or 0.0) > FALL_M_S
        for each in vehicles.values()
    )
    if outside := values.get("outside_envelope"):
        outside = f"outside the proven envelope: {outside}"
    return Group(
        _title(values), table, *map(Text, run), Text(f"judged from {', '.join(sources)}"),
        Text(_reasons(values) + problem), *([Text(FALLS, style="dim")] if fell else []),
        *(Text(each, style="yellow") for each in (outside, values.get("judged_apart"), unobserved) if each),
    )  # fmt: skip


def _reasons(values: Mapping[str, Any]) -> str:
    return "\n".join(f"{name}: {each['reason']}" for name, each in values["vehicles"].items())


def _title(values: Mapping[str, Any]) -> Text:
    about = (f"{name} {values[name]}" for name in _ABOUT if values.get(name) is not None)
    return Text(", ".join(about), style="italic")


def _shown(value: object, factor: float = 1.0) -> str:
    """Return a value of a result as text for a table."""
    return "-" if value is None else f"{value * factor:.3f}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Flown:
    """A finished run: its log, duration, onboard processes and problem."""

    about: Mapping[str, object]  # scenario, seed, filter, configuration: first keys of the JSON output
    folder: Path  # folder of the run's files
    log: Path | None  # path of the log; None: the run was not recorded
    wall_s: float  # wall time from the first tick to the end, s
    flights: Sequence[Followed]  # onboard processes, one for each vehicle
    problem: str | None  # error of a process, interruption or time-out; None: the run ended in order


def conclude(flown: Flown, console: Console, *, as_json: bool, with_report: bool) -> int:
    """Judge a run, write its report, print the result; return the exit status.

    Exit status 0: landed; 1: not landed, or a problem; 2: user code failed.
    """
    values = _concluded(flown, with_report=with_report)
    if as_json:
        print(json.dumps(values))
    else:
        console.print(result_table(values, f"; {flown.problem}" if flown.problem else ""))
        console.print(Text(f"log     {values['log'] or 'none, as asked for'}"), soft_wrap=True)
        if values["report"] is not None:
            console.print(Text(f"report  {values['report']}"), soft_wrap=True)
    last = "\n".join(each.last_line for each in flown.flights)  # last line of each onboard process
    landed = values["outcome"] == "landed" and flown.problem is None
    if problem := flown.problem or failed_code(_reasons(values)) or failed_code(last):
        print(f"flightstack: {problem}", file=sys.stderr)
    return 2 if failed_code(problem or "") else 0 if landed else 1


def _concluded(flown: Flown, *, with_report: bool) -> dict[str, Any]:
    """Judge a run and write its report; return the keys of ``--json``, with ``None`` for unknown values.

    Without a log, the outcome is that of the onboard process, and there are no measured values.
    """
    said = "; ".join(f"{each.namespace}: {each.last_line}" for each in flown.flights)
    try:
        log = load_fleet(flown.log) if flown.log is not None else None
    except LogError as error:  # the log is not usable
        unexplained = not said or any(each.child.process.returncode == 0 for each in flown.flights)
        if unexplained or not isinstance(error, EmptyLogError):  # otherwise the table contains the reason
            print(f"flightstack: no result: {flown.problem or said} {error}", file=sys.stderr)
        log = None
    if log is None:
        verdicts = {each.namespace: _of_process(each, flown.log) for each in flown.flights}
        values = fleet_verdict(verdicts).to_json_dict()
        vehicles = values.pop("members")
        path = str(flown.log) if flown.log is not None and flown.log.exists() else None
        more = {"realtime_factor": None, "log": path, "report": None, "vehicles": vehicles}
        return {**flown.about, **values, **more}
    verdict, page = judge_fleet(log), None
    if with_report:
        try:
            page = write_report(log, verdict, flown.folder / "report.html")
        except (ReportError, MissingExtraError) as error:  # the flight is valid without a report
            print(f"flightstack: {error}", file=sys.stderr)
    times = [flight.steps.t_s for flight in log.flights.values() if flight.steps is not None]
    longest_s = max((float(t_s[-1] - t_s[0]) for t_s in times), default=None)
    factor = longest_s / flown.wall_s if longest_s is not None and flown.wall_s > 0.0 else None
    return result(log, verdict, page, flown.about, factor)


def _of_process(flight: Followed, log: Path | None) -> Verdict:
    """Return the verdict on a flight without a usable log: the result that its onboard process reported."""
    landed = log is None and flight.child.process.returncode == 0
    outcome = Outcome.LANDED if landed else Outcome.UNKNOWN
    return Verdict(outcome=outcome, reason=flight.last_line, judged_from=PROCESS)
