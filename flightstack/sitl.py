"""``flightstack sitl``: run, judge, report, and say what was reached."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from rich.console import Console

from flightstack.launch import Run, RunOptions, result_json, run
from flightstack.processes import LaunchError
from flightstack.verdict_table import verdict_table
from logs.flight import load_flight
from logs.reader import LogError
from logs.report import ReportError, write_report
from logs.verdict import judge


def fly(options: RunOptions, *, as_json: bool, with_report: bool) -> int:
    """Fly, judge, print; the exit status.

    Raises:
        ConfigError: wrong input.
    """
    console = Console(stderr=as_json, highlight=False)
    try:
        flown = run(options, console)
    except LaunchError as error:
        print(f"flightstack: {error}", file=sys.stderr)
        return 1
    return conclude(flown, options, console, as_json=as_json, with_report=with_report)


def conclude(flown: Run, options: RunOptions, console: Console, *, as_json: bool, with_report: bool) -> int:
    """Judge the log of a run and print what was reached."""
    try:
        flight = load_flight(flown.log)
    except LogError as error:
        print(f"flightstack: no result: {flown.problem or ''} {error}", file=sys.stderr)
        return 1
    verdict = judge(flight)
    report = flown.folder / "report.html"
    if with_report:
        try:
            write_report(flown.log, report)
        except ReportError as error:  # the run counts all the same
            print(f"flightstack: {error}", file=sys.stderr)
    flown_s = float(flight.steps.t_s[-1] - flight.steps.t_s[0]) if flight.steps is not None else 0.0
    text = result_json(flown, options, verdict.to_json_dict(), flown_s, report)
    values = json.loads(text)
    if as_json:
        print(text)
    else:
        problem = f"; {flown.problem}" if flown.problem else ""
        console.print(verdict_table(values, verdict.reason + problem))
        _paths(console, flown.log, report if with_report else None)
    if flown.problem:
        print(f"flightstack: {flown.problem}", file=sys.stderr)
    return 0 if values["outcome"] == "landed" and flown.problem is None else 1


def _paths(console: Console, log: Path, report: Path | None) -> None:
    console.print(f"log     {log}", soft_wrap=True)
    if report is not None:
        console.print(f"report  {report}", soft_wrap=True)
