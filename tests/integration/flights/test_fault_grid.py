"""Tests that cells of the fault grid meet their requirements and equal docs/reference/fault_grid.md.

One cell is flown for each part and kind of failure, with the moments in turn; ``python -m tests.benchmarks
fault_grid`` flies all cells.
"""

from __future__ import annotations

import gc
import math
from dataclasses import fields

import pytest

from sim.runners.landing import land
from sim.vehicle.vehicle import warm_up
from tests.benchmarks.fault_grid import PAGE, complaints, demand, ends, row
from tests.fault_grid.run import SEED, equal, fly, scenario, undisturbed
from tests.fault_grid.table import GRID, End, Moment, Part, Way

MAKE_ANEW = "run: python -m tests.benchmarks fault_grid"
MOMENTS = tuple(Moment)
CELLS = {
    (part, way, MOMENTS[(i + j) % len(MOMENTS)]) for i, part in enumerate(Part) for j, way in enumerate(Way)
}
GROUPS = sorted({(part, moment) for part, _, moment in CELLS}, key=str)
# tolerances of the three columns (s, s, m), because other processors round differently
TOLERANCES = (0.1, 0.5, 0.01)
_FIRST_NUMBER = 5  # number of the first column with numbers in the page's tables


@pytest.fixture(scope="module", autouse=True)
def compiled():
    warm_up(scenario())
    gc.collect()
    gc.freeze()  # later garbage collections skip the compiler, which is loaded now


def test_the_grid_is_whole():
    assert set(GRID) == {(part, way, moment) for part in Part for way in Way for moment in Moment}
    assert len(GRID) == 168
    for need in GRID.values():
        assert need.ends
        assert need.why
        assert not need.ends & {End.CRASHED, End.MISSED, End.FLYING}
        assert bool(need.falls_short) == bool(need.short_ends)
        assert need.undetectable or need.within_s is None or need.within_s <= 10.0


def written(part: Part) -> dict[tuple[str, str], list[str]]:
    """Return the rows of a part's table as cells, by kind of failure and moment."""
    text = PAGE.read_text().partition(f"\n## {part[0].upper()}{part[1:]}\n")[2].partition("\n## ")[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if "|" in line]
    return {(cells[0], cells[1]): cells for cells in rows[2:]}


@pytest.mark.parametrize("part", Part)
def test_the_page_states_each_requirement(part):
    page = written(part)
    assert len(page) == len(Way) * len(Moment), MAKE_ANEW
    for way in Way:
        for moment in Moment:
            need, cells = GRID[part, way, moment], page[str(way), moment.name.lower()]
            assert (cells[2], cells[-1]) == (ends(need), demand(need)), MAKE_ANEW


@pytest.mark.parametrize(("part", "moment"), GROUPS, ids=[f"{p} in {m.name.lower()}" for p, m in GROUPS])
def test_ways_to_fail_end_as_demanded_and_as_the_page_says(part, moment):
    page, problems = written(part), []
    for way in (way for way in Way if (part, way, moment) in CELLS):
        need, result = GRID[part, way, moment], fly(part, way, moment)
        problems += [f"{part} {way} {moment.name}: {text}" for text in complaints(need, result)]
        fresh = [cell.strip() for cell in row(way, moment, need, result).split("|")[1:-1]]
        old = page[str(way), moment.name.lower()]
        if not same(old, fresh):
            problems.append(f"page: {old}, measured {fresh}; {MAKE_ANEW}")
        gc.collect()
    assert not problems, "\n".join(problems)


def same(old: list[str], fresh: list[str]) -> bool:
    """Whether two rows have equal texts, and numbers that are equal within the tolerances."""
    numbers = range(_FIRST_NUMBER - 1, _FIRST_NUMBER + 2)
    words = [i for i in range(len(fresh)) if i not in numbers]
    if [old[i] for i in words] != [fresh[i] for i in words]:
        return False
    return all(near(old[i], fresh[i], most) for i, most in zip(numbers, TOLERANCES, strict=True))


def near(a: str, b: str, most: float) -> bool:
    return a == b if "-" in (a, b) else math.isclose(float(a), float(b), abs_tol=most)


def test_without_a_fault_the_flight_is_that_of_a_landing_in_one_process():
    plain, watched = land(scenario(), SEED), undisturbed(Moment.APPROACH, SEED)
    assert plain.verdict.outcome == "landed"
    ticks = len(plain.seen.truth.t_s)
    names = [field.name for field in fields(watched.truth)]
    cut = type(watched.truth)(**{name: getattr(watched.truth, name)[:ticks] for name in names})
    assert equal(plain.seen.truth, cut)
