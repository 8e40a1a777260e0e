"""Flies the grid of faults, all 196 cells, and writes docs/reference/fault_grid.md."""

from __future__ import annotations

import gc
import math
from pathlib import Path

from sim.vehicle.vehicle import warm_up
from tests.fault_grid import fleet
from tests.fault_grid.run import SEED, Result, fly, scenario
from tests.fault_grid.table import GRID, H_MIN_M, WITHIN_S, End, Moment, Need, Part, Way

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "fault_grid.md"
_HEAD = f"""# Grid of faults

What becomes of a flight when one part fails for good, in one way, at one moment: 7 parts, 7 ways, 4 moments,
{len(GRID)} flights of the scenario `grid` with seed {SEED}. The table of what is demanded is
`tests/fault_grid/table.py`; a test flies every cell against it and this page. The page is made by

```
python -m tests.benchmarks fault_grid
```

Each flight begins on the ground, robust filter, firmware's velocity loops, touchdown by contact; the robot
drives off at 0.15 m/s when the landing begins. The fault begins when the companion enters the phase; in the
take-off 0.2 m above the ground, as nothing falls that stands. It lasts to the end.

| end | meaning |
|---|---|
| LANDED | rests upright on the pad, motors off |
| ABORTED | given up and declared; stands upright on the floor, motors off |
| VEHICLE_LANDS | the same, brought down by the autopilot's own fail-safe |
| CONTINUES | every true state of the flight equals that of the flight without the fault, to the last bit |
| CRASHED | tipped over, struck the robot, or touched down faster than 1 m/s |
| MISSED | on the floor and nobody had given up |
| FLYING | motors not off 30 s after the fault |

The last two are allowed nowhere, CRASHED only where the table says **falls short**. *Given up* counts from
the fault to the phase hold, climb or abort, or to a fail-safe of the autopilot; where it is demanded it must
come within {WITHIN_S:g} s, or as the table says, or the motors must be off by then. *Down* is when the motors
are off for good. The lowest h is the true one outside the pad, as long as the companion flies: until it has
flown clear, or the autopilot lands. It must not be below {H_MIN_M * 1000:g} mm unless the table says so.
Several ends stand where chance decides between safe ones.

Faults: `own state` (the estimate on its way to autopilot and companion), `heartbeat`, `set-point path` and
`clock` are those of [faults.md](faults.md) with their defaults; an own or target state that is wrong is 0.3 m
to the east, a delayed heartbeat 2 s late, an intermittent one pauses 2.5 s of 4. `target state` is the
tracker; `Zenoh link` acts on the bytes: stuck repeats one payload, garbage changes a byte of each, wrong is
another robot under the key, delayed 0.2 s with overtaking, intermittent loses bursts of 0.3 s. `log disk` is
a real recorder on a disk that is full, hangs, damages a byte of every write, is read-only, takes 1 MB/s, is
0.2 s late, or fails every third time.
"""
_TAIL = """
## What the companion knows

- The age of what comes: own state 0.2 s, target 0.25 s, heartbeat 3 s.
- Numbers that repeat to the last bit while they speak of more than 0.05 m/s, or for 0.5 s in flight:
  they age.
- Own position against own velocity over 2 s, more than `checks.own_drift_max_m` apart: lost, until
  they agree.
- Target samples farther than `checks.target_jump_max_m` from where the mean of the velocities of the last
  sample and of this one leads (of a lost target: the last velocity alone): refused; in flight for good, as
  nobody knows which of the two places is right.
- Target positions against target velocity over 2 s, more than `checks.target_drift_max_m` apart: lost, until
  they agree; at the second time in a flight for good. What flies clear goes by the positions.
- Velocity against the one wanted over 1 s: more than `checks.follow_lag_max_s` times the highest velocity
  behind is not following: the autopilot lands. How slowly it rises in a take-off counts after 7 s only.
- Disarmed, but in the air: one of the two is not true; the autopilot is told to land.

Without an own state no set-point is sent, and the autopilot lands where it is. What is wrong in position and
velocity alike from the start, late without a stamp that tells, or right by accident cannot be known on board.
"""


def row(way: Way, moment: Moment, need: Need, result: Result) -> str:
    """One line of the page."""
    ends = ", ".join(end for end in End if end in need.ends)
    return (
        f"| {way} | {moment.name.lower()} | {ends} | {result.end} | {_s(result.noticed_s)} "
        f"| {_s(result.down_s)} | {_s(result.h_min_m, 3)} | {demand(need)} |"
    )


def demand(need: Need) -> str:
    """Reason and limits in words."""
    parts = [need.why]
    if need.undetectable:
        parts.append("not to be known on board")
    if need.within_s not in (None, WITHIN_S):
        parts.append(f"within {need.within_s:g} s")
    if need.h_min_m != H_MIN_M:
        parts.append(f"h >= {need.h_min_m:g} m")
    if need.falls_short:
        parts.append(f"**falls short**: {need.falls_short}")
    return "; ".join(parts)


def complaints(need: Need, result: Result) -> list[str]:
    """What is demanded of a cell and not met."""
    found = []
    if result.end not in need.ends | need.short_ends:
        found.append(f"ended {result.end}, allowed: {', '.join(sorted(need.ends))}")
    known = [s for s in (result.noticed_s, result.down_s) if not math.isnan(s)]
    if need.within_s is not None and min(known, default=math.inf) > need.within_s:
        found.append(f"given up after {result.noticed_s:.2f} s, {need.within_s:g} s are allowed")
    if result.h_min_m < need.h_min_m:
        found.append(f"h fell to {result.h_min_m:.3f} m, {need.h_min_m:g} m are allowed")
    if math.isnan(result.down_s):
        found.append("the motors never stopped")
    return found


def _s(value: float, digits: int = 2) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def section(part: Part, rows: list[str]) -> str:
    """Table of one part."""
    return "\n".join(
        (
            f"\n## {part[0].upper()}{part[1:]}\n",
            "| way | in | demanded end | measured | given up, s | down, s | lowest h, m | why |",
            "|---|---|---|---|---|---|---|---|",
            *rows,
            "",
        )
    )


def main() -> None:
    """Fly all and write the page."""
    warm_up(scenario())
    gc.disable()
    sections = []
    for part in Part:
        rows = []
        for way in Way:
            for moment in Moment:
                need, result = GRID[part, way, moment], fly(part, way, moment)
                rows.append(row(way, moment, need, result))
                for text in complaints(need, result):
                    print(f"{part} {way} {moment.name}: {text}", flush=True)
                gc.collect()
        sections.append(section(part, rows))
        print(f"{part}: {len(rows)} cells", flush=True)
    PAGE.write_text(_HEAD + "".join(sections) + fleet.section() + _TAIL)
