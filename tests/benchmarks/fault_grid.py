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

Results of flights in which one part fails permanently, in one way, at one moment: 7 parts, 7 ways, 4
moments, {len(GRID)} flights of the scenario `grid` with seed {SEED}. `tests/fault_grid/table.py` has the
requirements; a test flies one cell for each requirement of a way to fail, and compares it with the
requirements and with this page. This command flies all cells and writes the page:

```
python -m tests.benchmarks fault_grid
```

Each flight starts on the ground, with the robust filter, the firmware's velocity loops, and touchdown by
contact; the robot drives off at 0.15 m/s when the landing starts. The fault begins when the companion
enters the phase (take-off: 0.2 m above the ground, because a standing vehicle cannot fall) and lasts to the
end.

| end | meaning |
|---|---|
| LANDED | rests upright on the pad, motors off |
| ABORTED | aborted and reported; stands upright on the floor, motors off |
| VEHICLE_LANDS | the same, brought down by the autopilot's own fail-safe |
| CONTINUES | every true state of the flight equals that of the flight without the fault, to the last bit |
| CRASHED | tipped over, struck the robot, or touched down faster than 1 m/s |
| MISSED | on the floor without an abort |
| FLYING | motors not off 30 s after the fault |

The last two are never allowed, CRASHED only where the table says **falls short**. *Given up* is the time
from the fault to the phase hold, climb or abort, or to a fail-safe of the autopilot. If it is required, it
must be at most {WITHIN_S:g} s, or the value in the table, or the motors must be off by then. *Down* is the
time until the motors are off for good. *Lowest h* is the true one outside the pad while the companion
flies: until it has flown clear, or the autopilot lands. It must be at least {H_MIN_M * 1000:g} mm unless
the table has another value. A cell has several allowed ends if chance decides between safe ones.

Faults: `vehicle state` (the estimate on its way to autopilot and companion), `heartbeat`, `set-point path`
and `clock` are those of [faults.md](faults.md) with their defaults. A wrong vehicle or target state is 0.3
m too far east; a delayed heartbeat is 2 s late; an intermittent one pauses 2.5 s of 4. `target state` is
a fault of the robot's tracker. `Zenoh link` changes the bytes: stuck repeats one payload, garbage changes
a byte of each, wrong is another robot with the same key,
delayed is 0.2 s with overtaking, intermittent loses bursts of 0.3
s. `log disk` is a real recorder on a disk that is full, hangs, damages a byte of every write, is read-only,
takes 1 MB/s, is 0.2 s late, or fails every third time.
"""
_TAIL = """
## What the companion can detect

- Old data: vehicle state 0.2 s, target 0.25 s, heartbeat 3 s.
- Repeated data: numbers that repeat to the last bit, while they contain a velocity of more than 0.05 m/s,
  or for 0.5 s in flight, count as old.
- A vehicle position that contradicts the vehicle velocity: more than `checks.own_drift_max_m` apart over 2
  s. The state counts as lost until both agree.
- A target sample that jumps: farther than `checks.target_jump_max_m` from the prediction with the mean
  velocity of the last sample and this one (for a lost target: with the last velocity). The sample is
  refused, in flight for good, because it is unknown which of the two positions is right.
- Target positions that contradict the target velocity: more than `checks.target_drift_max_m` apart over 2
  s. The target counts as lost until both agree, and after the second time for the rest of the flight.
  Flying clear uses the positions.
- A vehicle that does not follow its set-points: over 1 s the velocity lags by more than
  `checks.follow_lag_max_s` times the highest velocity. The autopilot lands. In a take-off the rate of climb
  counts after 7 s only.
- Disarmed, but in the air: one of the two is wrong; the autopilot is commanded to land.

Without a vehicle state no set-point is sent, and the autopilot lands where it is. The companion cannot
detect a state whose position and velocity are wrong alike from the start, or that is late without a time
stamp.
"""


def row(way: Way, moment: Moment, need: Need, result: Result) -> str:
    return (
        f"| {way} | {moment.name.lower()} | {ends(need)} | {result.end} | {_s(result.noticed_s)} "
        f"| {_s(result.down_s)} | {_s(result.h_min_m, 3)} | {demand(need)} |"
    )


def ends(need: Need) -> str:
    return ", ".join(end for end in End if end in need.ends)


def demand(need: Need) -> str:
    """Reason and limits in words."""
    parts = [need.why]
    if need.undetectable:
        parts.append("not detectable on board")
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
