"""Flies the grid of faults, all 168 cells, and writes the tables of docs/reference/fault_grid.md."""

from __future__ import annotations

import gc
import math
from pathlib import Path

from sim.vehicle.vehicle import warm_up
from tests.fault_grid import fleet
from tests.fault_grid.run import Result, fly, scenario
from tests.fault_grid.table import GRID, H_MIN_M, WITHIN_S, End, Moment, Need, Part, Way

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "fault_grid.md"
# headings before and after the generated tables; all other text of the page is written by hand
_FIRST, _LAST = "\n## Vehicle state\n", "\n## What the companion can detect\n"


def row(way: Way, moment: Moment, need: Need, result: Result) -> str:
    return (
        f"| {way} | {moment.name.lower()} | {ends(need)} | {result.end} | {_s(result.noticed_s)} "
        f"| {_s(result.down_s)} | {_s(result.h_min_m, 3)} | {demand(need)} |"
    )


def ends(need: Need) -> str:
    return ", ".join(end for end in End if end in need.ends)


def demand(need: Need) -> str:
    """Return the reason and those limits of a requirement that differ from the defaults, as text."""
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
    """Return one text for each requirement that the flight of a cell does not meet."""
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
    """Return the table of the faults of one component."""
    return "\n".join(
        (
            f"\n## {part[0].upper()}{part[1:]}\n",
            "| failure | phase | allowed end | measured end | given up, s | down, s | lowest h, m | reason |",
            "|---|---|---|---|---|---|---|---|",
            *rows,
            "",
        )
    )


def main() -> None:
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
    text = PAGE.read_text()
    head, tail = text.partition(_FIRST)[0], _LAST + text.partition(_LAST)[2]
    PAGE.write_text(head + "".join(sections) + fleet.section() + tail)
