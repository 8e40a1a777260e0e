"""Rows of a campaign, one for each landing of a vehicle or team, and the file to which rows are appended.

Floats keep every bit in the file; an empty field means "not known", never zero.
"""

from __future__ import annotations

import csv
import io
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from flightstack.common.text import failed_code
from flightstack.core.types import Phase
from logs.schema import member_name
from logs.verdict.types import Outcome
from logs.verdict.verdict import FleetVerdict, fleet_verdict
from sim.runners.landing import Landing

ERROR = "error"  # outcome of a landing that could not be simulated to the end
_OUTCOMES = frozenset({ERROR, *(outcome.value for outcome in Outcome)})
CELL_M = 0.1  # width and height of a cell in the map of h, m
E_Z_LOW_M = -0.3  # lower edge of the lowest cells of the map, m; these cells include all lower values
D_CELLS, E_Z_CELLS = 30, 30  # numbers of cells of the map; the last cells include all larger values
# columns with the duration of a phase
_TIMED = {
    "approach_s": Phase.APPROACH, "land_s": Phase.LAND, "touchdown_s": Phase.TOUCHDOWN,
    "hold_s": Phase.HOLD, "climb_s": Phase.CLIMB, "abort_s": Phase.ABORT,
}  # fmt: skip
# columns that are fields of the verdict on the run
_JUDGED = (
    "reason", "violation", "started_safe", "h_min_m", "h_min_outside_pad_m", "touchdown_error_m",
    "touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s", "time_to_land_s", "collisions",
    "ellipsoid_violations", "ellipsoid_min", "distance_min_m",
)  # fmt: skip


class RowsError(ValueError):
    """A file of rows that cannot be used."""


@dataclass(frozen=True, slots=True)
class Row:
    """Values of one landing in the file of rows; ``None`` if a value does not apply or is not known."""

    seed: int  # seed of all random draws
    outcome: str  # ``Outcome``, or "error"
    reason: str  # sentence that explains the outcome
    # whether h < -5 mm outside the pad (``Verdict.violation``); None: data are missing
    violation: bool | None = None
    started_safe: bool | None = None  # whether h >= 0 at the start of the landing; None: unknown
    h_min_m: float | None = None  # lowest true h
    h_min_outside_pad_m: float | None = None  # lowest true h where d > pad radius
    h_min_d_m: float | None = None  # horizontal distance d at the tick of ``h_min_m``
    h_min_e_z_m: float | None = None  # height e_z at the tick of ``h_min_m``
    touchdown_error_m: float | None = None  # horizontal distance d at first contact
    touchdown_speed_vertical_m_s: float | None = None  # sink rate relative to the pad at first contact
    touchdown_speed_horizontal_m_s: float | None = None  # horizontal speed relative to the pad at contact
    time_to_land_s: float | None = None  # time from the start of the landing to first contact, if landed
    retries: int | None = None  # number of go-arounds, which return to the approach
    # duration of each phase, s
    approach_s: float | None = None
    land_s: float | None = None
    touchdown_s: float | None = None
    hold_s: float | None = None
    climb_s: float | None = None
    abort_s: float | None = None
    own_age_max_s: float | None = None  # largest age of the vehicle state since the landing started
    target_age_max_s: float | None = None  # largest age of the target state since the landing started
    simulated_s: float | None = None  # duration of the run, simulated time
    wall_s: float | None = None  # wall time, s; the only value that the seed does not determine
    cells: str = ""  # map of h: "i j mm" for each visited cell (i, j) of (d, e_z); mm: lowest h in this cell
    outcomes: str = ""  # outcomes of all vehicles, cf1 first; empty for one vehicle, as the next fields are
    collisions: int | None = None  # number of pairs of vehicles that collided
    # number of times that two vehicles in flight entered the ellipsoid around each other
    ellipsoid_violations: int | None = None
    ellipsoid_min: float | None = None  # smallest ellipsoid norm between two flying vehicles; below 1: inside
    distance_min_m: float | None = None  # smallest distance between two vehicles
    wait_max_s: float | None = None  # longest time for which a vehicle waited for the right of way
    # keys with which the scenario exceeds its configuration's proof; also given for single vehicles
    outside_envelope: str = ""

    @property
    def landed(self) -> bool:
        """Whether the outcome of the run is ``landed``."""
        return self.outcome == Outcome.LANDED

    def untimed(self) -> Row:
        """Return the row without its wall time; such rows are equal for equal seeds."""
        return replace(self, wall_s=None)


def judge_landing(flown: Landing) -> FleetVerdict:
    """Return the verdict on a run; the verdict on the log of the run is equal."""
    names = {number: member_name(number) for number, _ in enumerate(flown.members, 1)}
    members = {names[n]: landing.verdict for n, landing in enumerate(flown.members, 1)}
    return fleet_verdict(members, flown.pairs, names)


def row_of(flown: Landing) -> Row:
    """Return the row of a run: retries and phase durations as sums, all other values of the worst vehicle."""
    verdict, vehicles = judge_landing(flown), [_values(landing) for landing in flown.members]
    deepest = min(vehicles, key=lambda each: each["h_min_outside_pad_m"])
    known = {name: [each[name] for each in vehicles if each[name] is not None] for name in vehicles[0]}
    # vehicles that had neighbours
    paired = sorted({number - 1 for pair in flown.pairs for number in (pair.one, pair.other)})
    return Row(
        seed=flown.seed,
        outcome=verdict.outcome.value,
        **{name: getattr(verdict, name) for name in _JUDGED},
        h_min_d_m=deepest["h_min_d_m"],
        h_min_e_z_m=deepest["h_min_e_z_m"],
        **{name: sum(known[name]) for name in ("retries", *_TIMED)},
        own_age_max_s=max(known["own_age_max_s"], default=None),
        target_age_max_s=max(known["target_age_max_s"], default=None),
        simulated_s=max(each.simulated_s for each in flown.members),
        wall_s=flown.wall_s,
        cells=_cells(*map(np.concatenate, zip(*known["cells"], strict=True))),
        outcomes=" ".join(verdict.outcomes[n] for n in paired),
        wait_max_s=max((flown.members[n].wait_s for n in paired), default=None),
    )


def _values(landing: Landing) -> dict[str, Any]:
    """Return the values of one vehicle by column; ``cells`` has d, e_z and h since the landing started."""
    h_m, seen = landing.verdict.h_min_outside_pad_m, landing.seen
    steps, truth, start_s = seen.steps, seen.truth, seen.landing_start_s
    begin = len(truth.t_s) if start_s is None else int(np.searchsorted(truth.t_s, start_s))
    lowest_d_m = lowest_e_z_m = None
    outside_m = truth.h_min_outside_pad_m[begin:]
    if h_m is not None:
        at = begin + int(np.argmin(np.where(np.isnan(outside_m), np.inf, outside_m)))
        lowest_d_m, lowest_e_z_m = float(truth.d_m[at]), float(truth.e_m[at, 2])
    # the phase of a step lasts until the next step
    lengths_s = np.diff(steps.t_s, append=steps.t_s[-1])
    landing_steps = slice(0, 0) if start_s is None else slice(int(np.searchsorted(steps.t_s, start_s)), None)
    return {
        "h_min_outside_pad_m": math.inf if h_m is None else h_m,
        "h_min_d_m": lowest_d_m,
        "h_min_e_z_m": lowest_e_z_m,
        "retries": landing.retries,
        **{name: float(lengths_s[steps.phase == phase].sum()) for name, phase in _TIMED.items()},
        "own_age_max_s": _largest(steps.own_age_s[landing_steps]),
        "target_age_max_s": _largest(steps.target_age_s[landing_steps]),
        "cells": (truth.d_m[begin:], truth.e_m[begin:, 2], truth.h_m[begin:]),
    }


def error_row(seed: int, reason: str) -> Row:
    """Return the row of a landing that could not be flown; the row counts as a failure."""
    return Row(seed, ERROR, " ".join(reason.split()))


def failed_rows(rows: Iterable[Row]) -> str:
    """Return a text with the first failure of user code and the number of such rows; empty: no failure."""
    found = [(row.seed, text) for row in rows if (text := failed_code(row.reason))]
    return f"seed {found[0][0]}: {found[0][1]}; {len(found)} landings ended so" if found else ""


def cell_map(rows: Iterable[Row]) -> tuple[Any, Any]:
    """Return lowest h (m, NaN: no landing) and number of landings in each cell, (E_Z_CELLS, D_CELLS) each."""
    lowest = np.full((E_Z_CELLS, D_CELLS), np.inf)
    visits = np.zeros((E_Z_CELLS, D_CELLS), dtype=np.int64)
    for cell in (each for row in rows for each in filter(None, row.cells.split(";"))):
        i, j, h_mm = map(int, cell.split())
        lowest[j, i] = min(lowest[j, i], h_mm * 1e-3)
        visits[j, i] += 1
    return np.where(np.isfinite(lowest), lowest, np.nan), visits


def _cells(d_m: Any, e_z_m: Any, h_m: Any) -> str:
    i = np.clip((d_m / CELL_M).astype(np.int64), 0, D_CELLS - 1)
    j = np.clip(((e_z_m - E_Z_LOW_M) / CELL_M).astype(np.int64), 0, E_Z_CELLS - 1)
    cell = j * D_CELLS + i
    order = np.lexsort((h_m, cell))  # the lowest h of each cell comes first
    visited, first = np.unique(cell[order], return_index=True)
    h_mm = np.floor(h_m[order][first] * 1e3).astype(np.int64)
    return ";".join(f"{c % D_CELLS} {c // D_CELLS} {h}" for c, h in zip(visited, h_mm, strict=True))


def _largest(ages_s: Any) -> float | None:
    known = ages_s[np.isfinite(ages_s)]
    return float(known.max()) if len(known) else None


_NAMES = [f.name for f in fields(Row)]
_HEADER = ",".join(_NAMES) + "\r\n"


def _text(row: Row) -> str:
    out = io.StringIO()
    values = (getattr(row, name) for name in _NAMES)
    csv.writer(out).writerow(str(value).lower() if isinstance(value, bool) else value for value in values)
    return out.getvalue()


def _row(values: list[str]) -> Row:
    given = {name: value for name, value in zip(_NAMES, values, strict=True) if value}
    # equal texts share one object: a million landings have few different reasons
    row = msgspec.convert({**given, "reason": sys.intern(given.get("reason", ""))}, Row, strict=False)
    if row.outcome not in _OUTCOMES:
        raise ValueError(f"the outcome is {row.outcome!r}")
    for name in _NAMES:
        if isinstance(value := getattr(row, name), float) and not math.isfinite(value):
            raise ValueError(f"{name} is {value}, a finite number is needed")
    return row


def read_rows(path: Path) -> list[Row]:
    """Read a file of rows up to its first incomplete line; if a seed has several rows, return the last.

    A campaign may still append to the file: a line that is incomplete now can be complete in the next read.

    Raises RowsError: the file has a wrong format or a damaged line.
    """
    rows: list[Row] = []
    with path.open(newline="", encoding="utf-8-sig") as file:
        try:
            lines = takewhile(lambda line: line.endswith("\n"), iter(file.readline, ""))
            head = next(lines, None)
            if head is not None and head.rstrip("\r\n") != _HEADER.rstrip():
                raise RowsError(f"{path}: the first line is not that of a file of rows; give another --out")
            for values in csv.reader(lines):
                rows.append(_row(values))
        except RowsError:
            raise
        except (ValueError, csv.Error) as error:
            if isinstance(error, UnicodeDecodeError) and not rows and error.start == 0:
                text = "found UTF-16 or another encoding; save it as UTF-8, or give another --out"
                raise RowsError(f"{path}: {text}") from None
            where = f"{path}, line {len(rows) + 2}"
            raise RowsError(f"{where}: not a row ({error}); give another --out") from None
    return list({row.seed: row for row in rows}.values())


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Replace the file by all rows, ordered by seed, atomically."""
    beside = path.with_suffix(".tmp")
    with beside.open("w", newline="", encoding="utf-8") as file:
        file.write(_HEADER)
        file.writelines(_text(row) for row in sorted(rows, key=lambda row: row.seed))
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


@contextmanager
def appending(path: Path) -> Iterator[Callable[[Row], None]]:
    """Open a file of rows, cut off an incomplete last line; yield a function that stores a row durably."""
    with path.open("a+b") as file:
        file.seek(0)
        whole = file.read().rfind(b"\n") + 1
        file.truncate(whole)
        if not whole:
            file.write(_HEADER.encode())

        def add(row: Row) -> None:
            file.write(_text(row).encode())
            file.flush()
            os.fsync(file.fileno())

        yield add
