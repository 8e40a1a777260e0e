"""Summary of a campaign: counts, confidence bounds, quantiles, worst seeds.

An unknown result counts as a failure: a row with outcome "error" is an undeclared miss, and an unknown
violation is a violation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy  # loads each part at the first use of the part, in 0.3 to 0.5 s

from logs.verdict.types import Outcome
from sim.campaign.rows import ERROR, Row

CONFIDENCE = 0.95
WORST_MAX = 10
_QUANTILES = {
    "touchdown_error_m": {"median": 0.5, "p95": 0.95},
    "touchdown_speed_vertical_m_s": {"p95": 0.95},
    "touchdown_speed_horizontal_m_s": {"p95": 0.95},
    "time_to_land_s": {"median": 0.5},
}
_RANK = {ERROR: 0, Outcome.CRASHED: 1, Outcome.TIMEOUT: 3, Outcome.ABORTED: 4, Outcome.LANDED: 5}
_VIOLATED_RANK = 2


def count(rows: Sequence[Row]) -> dict[str, int]:
    """Count outcomes; every row is in exactly one of landed, aborts, misses and crashes."""
    outcomes = [row.outcome for row in rows]
    return {
        "runs": len(rows),
        "landed": outcomes.count(Outcome.LANDED),
        "declared_aborts": outcomes.count(Outcome.ABORTED),
        "undeclared_misses": outcomes.count(Outcome.TIMEOUT) + outcomes.count(ERROR),
        "crashes": outcomes.count(Outcome.CRASHED),
        "violations": sum(row.violation is not False for row in rows),
    }


def kinds(row: Row) -> list[str]:
    """Return the names under which a progress bar counts a landing: outcome, ``violations`` if violated."""
    return [row.outcome, *(["violations"] if row.violation else [])]


def upper_bound(events: int, runs: int, confidence: float = CONFIDENCE) -> float:
    """Return the one-sided upper Clopper-Pearson bound p of a rate: P(X <= events) = 1 - confidence."""
    if not 0 <= events <= runs or runs < 1:
        raise ValueError(f"{events} events in {runs} runs: a number of runs and no more events are needed")
    return 1.0 if events == runs else float(scipy.special.betaincinv(events + 1, runs - events, confidence))


def quantile(rows: Sequence[Row], column: str, share: float) -> float | None:
    """Return a quantile of a column over the landings with outcome landed; None: no such landing."""
    known = [v for row in rows if row.landed and (v := getattr(row, column)) is not None]
    return float(np.quantile(known, share)) if known else None


def summary(
    rows: Sequence[Row], command: str, *, wall_s: float, flown_s: float, judged_apart: str = ""
) -> dict[str, Any]:
    """Return the object that ``--json`` prints.

    ``rows``: one or more; ``command``: command that repeats one seed, with ``{seed}``; ``wall_s``: wall time
    of this call; ``flown_s``: simulated time of this call; ``judged_apart``: text that names the barriers of
    verdict and flight, and the boundary of a user's filter; empty if there is no difference.
    """
    counts = count(rows)
    lowest = [row.h_min_outside_pad_m for row in rows if row.h_min_outside_pad_m is not None]
    return {
        **counts,
        "upper_95_violation_rate": upper_bound(counts["violations"], counts["runs"]),
        "h_min_outside_pad_m": min(lowest, default=None),
        **{
            column: {name: quantile(rows, column, share) for name, share in shares.items()}
            for column, shares in _QUANTILES.items()
        },
        **_of_rooms(rows),
        "outside_envelope": next(filter(None, (row.outside_envelope for row in rows)), ""),
        "judged_apart": judged_apart,
        "wall_s": wall_s,
        "realtime_factor": flown_s / wall_s if flown_s > 0.0 and wall_s > 0.0 else None,
        "worst": [
            {"seed": row.seed, "why": why(row), "command": command.format(seed=row.seed)}
            for row in worst(rows)
        ],
    }


# values over all vehicles, and the function that combines the values of all rows
_OF_ROOMS: Mapping[str, Callable[[Iterable[Any]], Any]] = {
    "vehicles": sum, "vehicles_landed": sum, "collisions": sum, "ellipsoid_violations": sum,
    "ellipsoid_min": min, "distance_min_m": min, "wait_max_s": max,
}  # fmt: skip


def _of_rooms(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the values of all vehicles together; a value that no row has is left out."""
    found: dict[str, list[Any]] = {
        name: [value for row in rows if (value := getattr(row, name, None)) is not None] for name in _OF_ROOMS
    }
    ends = [row.outcomes.split() for row in rows if row.outcomes]
    found["vehicles"] = [len(each) for each in ends]
    found["vehicles_landed"] = [each.count(Outcome.LANDED) for each in ends]
    return {name: join(found[name]) for name, join in _OF_ROOMS.items() if found[name]}


def worst(rows: Sequence[Row], most: int = WORST_MAX) -> list[Row]:
    """Return the worst rows: failures first, then by the distance of the touchdown from the pad's centre."""
    return sorted(rows, key=_badness)[:most]


def _badness(row: Row) -> tuple[float, float, float, int]:
    violated = row.violation is not False and row.outcome != ERROR
    rank = min(_RANK[row.outcome], _VIOLATED_RANK) if violated else _RANK[row.outcome]
    h_m = row.h_min_outside_pad_m
    lowest_m = h_m if h_m is not None and violated else math.inf
    return rank, lowest_m, -(row.touchdown_error_m or 0.0), row.seed


def why(row: Row) -> str:
    """Return the reason, in one line, why a row is among the worst."""
    if row.landed and row.violation is False:
        return f"landed {100.0 * (row.touchdown_error_m or 0.0):.1f} cm from the centre"
    told = f"{row.outcome}: {row.reason}"
    if row.violation is False:
        return told
    h_m = row.h_min_outside_pad_m
    found = f"h down to {1e3 * h_m:.0f} mm" if row.violation and h_m is not None else "cannot be excluded"
    return f"{told}; violation {found}"


# lines of the printed summary: key, key within the value if the value is an object, name, unit, factor
_LINES: tuple[tuple[str, str, str, str, float], ...] = (
    ("runs", "", "landings flown", "", 1.0),
    ("landed", "", "landed", "", 1.0),
    ("declared_aborts", "", "aborted, declared", "", 1.0),
    ("undeclared_misses", "", "missed, not declared", "", 1.0),
    ("crashes", "", "crashed", "", 1.0),
    ("violations", "", "barrier violated, or not known", "", 1.0),
    ("upper_95_violation_rate", "", "violation rate, upper bound (95 %)", "%", 100.0),
    ("h_min_outside_pad_m", "", "lowest h outside the pad", "mm", 1e3),
    ("touchdown_error_m", "median", "touchdown error, median", "cm", 100.0),
    ("touchdown_error_m", "p95", "touchdown error, 95 %", "cm", 100.0),
    ("touchdown_speed_vertical_m_s", "p95", "touchdown speed, vertical, 95 %", "m/s", 1.0),
    ("touchdown_speed_horizontal_m_s", "p95", "touchdown speed, horizontal, 95 %", "m/s", 1.0),
    ("time_to_land_s", "median", "time to land, median", "s", 1.0),
    ("vehicles", "", "vehicles flown", "", 1.0),
    ("vehicles_landed", "", "vehicles landed", "", 1.0),
    ("collisions", "", "collisions", "", 1.0),
    ("ellipsoid_violations", "", "ellipsoid violations", "", 1.0),
    ("ellipsoid_min", "", "smallest distance in the ellipsoid's measure", "", 1.0),
    ("distance_min_m", "", "smallest distance of two vehicles", "m", 1.0),
    ("wait_max_s", "", "longest wait for another vehicle", "s", 1.0),
    ("wall_s", "", "wall time of this call", "s", 1.0),
    ("realtime_factor", "", "simulated time over wall time", "", 1.0),
)


def apart(told: dict[str, Any]) -> list[str]:
    """Return sentences about landings outside the proven envelope, or judged with a different barrier."""
    outside = told["outside_envelope"] and f"outside the proven envelope: {told['outside_envelope']}"
    return [line for line in (outside, told["judged_apart"]) if line]


def lines(told: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return the rows of the printed summary: name, value as text, unit."""
    found = []
    for key, part, name, unit, factor in _LINES:
        if key in told:
            value = told[key][part] if part else told[key]
            shown = (
                "–" if value is None else f"{factor * value:.4g}" if isinstance(value, float) else str(value)
            )
            found.append((name, shown, unit))
    return found
