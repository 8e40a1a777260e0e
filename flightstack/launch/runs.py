"""Several runs of ``sitl``: a folder each, a table and a summary."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Column, Table

from flightstack.common.hangup import CalledOffError
from flightstack.common.processes import LaunchError
from flightstack.launch.result import concluded, landed, shown
from flightstack.launch.run_options import RunOptions
from flightstack.launch.sitl import run
from flightstack.onboard.recording import new_folder

Row = Mapping[str, object]
_COLUMNS = (
    ("seed", "seed"),
    ("outcome", "outcome"),
    ("violation", "violation"),
    ("error, m", "touchdown_error_m"),
    ("speed down, m/s", "touchdown_speed_vertical_m_s"),
    ("lowest h outside the pad, m", "h_min_outside_pad_m"),
    ("time, s", "time_to_land_s"),
    ("real-time factor", "realtime_factor"),
)


def fly_all(options: RunOptions, console: Console) -> int:
    """Fly with the seeds from ``options.seed`` on, each in a folder of its own; print a table and a summary.

    A run that does not start counts as not landed, and the next is flown; Ctrl-C ends after the current one.
    Returns the exit status: 0 all landed, 1 some did not.

    Raises ConfigError: wrong input.
    """
    runs = options.runs
    base = options.out or new_folder(f"{Path(options.scenario).stem}-{runs}-runs")
    rows: list[Row] = []
    for seed in range(options.seed, options.seed + runs):
        try:
            flown = run(replace(options, seed=seed, out=base / f"seed{seed}"), console)
        except CalledOffError:
            break
        except LaunchError as error:
            console.print(f"seed {seed}: {error}", style="red", markup=False)
            rows.append({"seed": seed, "outcome": None, "reason": str(error), "problem": str(error)})
            continue
        values = concluded(flown, with_report=options.with_report)
        rows.append({**values, "problem": flown.problem, "landed": landed(values, flown)})
        line = "  ".join(f"{name} {shown(values.get(key))}" for name, key in _COLUMNS)
        console.print(line, soft_wrap=True, markup=False)
        if flown.interrupted:
            break
    summary = sum_up(rows, runs)
    console.print(_table(rows))
    if options.as_json:
        print(json.dumps(summary))
    else:
        console.print(
            "  ".join(f"{name} {shown(value)}" for name, value in summary.items() if name != "rows")
        )
    return 0 if summary["landed"] == runs else 1


def sum_up(rows: Sequence[Row], runs: int) -> dict[str, object]:
    """Return counts and medians of several runs.

    ``rows``: values of each run, with ``landed``; ``runs``: number of requested runs.
    """
    counts = Counter(row.get("outcome") for row in rows)
    return {
        "runs": runs,
        "flown": len(rows),
        "landed": sum(row.get("landed") is True for row in rows),
        "crashed": counts["crashed"],
        "aborted": counts["aborted"],
        "violations": sum(row.get("violation") is True for row in rows),
        "touchdown_error_m": _median(rows, "touchdown_error_m"),
        "touchdown_error_max_m": max(_numbers(rows, "touchdown_error_m"), default=None),
        "touchdown_speed_vertical_m_s": _median(rows, "touchdown_speed_vertical_m_s"),
        "time_to_land_s": _median(rows, "time_to_land_s"),
        "realtime_factor": _median(rows, "realtime_factor"),
        "rows": list(rows),
    }


def _numbers(rows: Sequence[Row], key: str) -> list[float]:
    return [value for row in rows if isinstance(value := row.get(key), float)]


def _median(rows: Sequence[Row], key: str) -> float | None:
    found = _numbers(rows, key)
    return median(found) if found else None


def _table(rows: Sequence[Row]) -> Table:
    table = Table(*(Column(name, justify="right") for name, _ in _COLUMNS))
    for row in rows:
        table.add_row(*(shown(row.get(key)) for _, key in _COLUMNS))
    return table
