"""The verdict on a team, and its row in a campaign: of each value the worst of the members'."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from logs.verdict.types import Outcome
from sim.campaign.rows import Row, row_of
from sim.runners.team import TeamLanding

_WORST_FIRST = (Outcome.CRASHED, Outcome.TIMEOUT, Outcome.ABORTED, Outcome.LANDED)


@dataclass(frozen=True, slots=True)
class TeamVerdict:
    """What became of a team.

    Attributes:
        outcome: the worst of the members'.
        outcomes: of the members, cf1 first; who collides at any time has crashed, also after its landing.
        reason: why, in words.
        collisions: pairs whose shapes overlapped.
        ellipsoid_violations: times that two vehicles in flight came inside the ellipsoid about each other.
        ellipsoid_min: smallest distance of two vehicles in flight in its measure; None: no two at once.
        distance_min_m: smallest distance of two vehicles' centres of mass; None: a team of one.
    """

    outcome: Outcome
    outcomes: tuple[Outcome, ...]
    reason: str
    collisions: int
    ellipsoid_violations: int
    ellipsoid_min: float | None
    distance_min_m: float | None


def judge_team(flown: TeamLanding) -> TeamVerdict:
    """Judge a team by its members' verdicts and by how near they came to each other."""
    struck = [pair for pair in flown.pairs if pair.collided_ms is not None]
    hit = {number for pair in struck for number in (pair.one, pair.other)}
    outcomes = tuple(
        Outcome.CRASHED if number in hit else landing.verdict.outcome
        for number, landing in enumerate(flown.landings, 1)
    )
    outcome = min(outcomes, key=_WORST_FIRST.index)
    return TeamVerdict(
        outcome,
        outcomes,
        _reason(flown, outcome, outcomes, hit),
        len(struck),
        sum(pair.violations for pair in flown.pairs),
        _least(pair.ellipsoid_min for pair in flown.pairs),
        _least(pair.distance_min_m for pair in flown.pairs),
    )


def _reason(flown: TeamLanding, outcome: Outcome, outcomes: Sequence[Outcome], hit: set[int]) -> str:
    if outcome is Outcome.LANDED:
        return f"all {len(outcomes)} landed"
    numbers = [number for number, each in enumerate(outcomes, 1) if each is outcome]
    whys = [f"cf{n}: {'collision' if n in hit else flown.landings[n - 1].verdict.reason}" for n in numbers]
    return "; ".join(whys)


def team_row(flown: TeamLanding) -> Row:
    """Make the row of a team: sums of retries and of times in the phases, of everything else the worst."""
    verdict = judge_team(flown)
    rows = [row_of(landing) for landing in flown.landings]
    deepest = min(rows, key=lambda row: _or(row.h_min_outside_pad_m, float("inf")))
    all_landed = verdict.outcome is Outcome.LANDED
    return Row(
        seed=flown.seed,
        outcome=verdict.outcome.value,
        reason=verdict.reason,
        violation=_any(row.violation for row in rows),
        started_safe=_all(row.started_safe for row in rows),
        h_min_m=_least(row.h_min_m for row in rows),
        h_min_outside_pad_m=deepest.h_min_outside_pad_m,
        h_min_d_m=deepest.h_min_d_m,
        h_min_e_z_m=deepest.h_min_e_z_m,
        touchdown_error_m=_most(row.touchdown_error_m for row in rows),
        touchdown_speed_vertical_m_s=_most(row.touchdown_speed_vertical_m_s for row in rows),
        touchdown_speed_horizontal_m_s=_most(row.touchdown_speed_horizontal_m_s for row in rows),
        time_to_land_s=_most(row.time_to_land_s for row in rows) if all_landed else None,
        retries=sum(row.retries or 0 for row in rows),
        approach_s=_sum(rows, lambda row: row.approach_s),
        land_s=_sum(rows, lambda row: row.land_s),
        touchdown_s=_sum(rows, lambda row: row.touchdown_s),
        hold_s=_sum(rows, lambda row: row.hold_s),
        climb_s=_sum(rows, lambda row: row.climb_s),
        abort_s=_sum(rows, lambda row: row.abort_s),
        own_age_max_s=_most(row.own_age_max_s for row in rows),
        target_age_max_s=_most(row.target_age_max_s for row in rows),
        simulated_s=flown.simulated_s,
        wall_s=flown.wall_s,
        cells=_cells(rows),
        outcomes=" ".join(verdict.outcomes),
        collisions=verdict.collisions,
        ellipsoid_violations=verdict.ellipsoid_violations,
        ellipsoid_min=verdict.ellipsoid_min,
        distance_min_m=verdict.distance_min_m,
    )


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _least(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and value < float("inf")]
    return min(known, default=None)


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _sum(rows: Sequence[Row], value: Callable[[Row], float | None]) -> float:
    return sum(_or(value(row), 0.0) for row in rows)


def _any(values: Iterable[bool | None]) -> bool | None:
    """Whether one is true; None if that is not known."""
    found = set(values)
    return True if True in found else None if None in found else False


def _all(values: Iterable[bool | None]) -> bool | None:
    """Whether all are true; None if that is not known."""
    found = set(values)
    return False if False in found else None if None in found else True


def _cells(rows: Sequence[Row]) -> str:
    """The members' maps of h in one, with the lowest h of each cell."""
    lowest: dict[tuple[int, int], int] = {}
    for row in rows:
        for cell in filter(None, row.cells.split(";")):
            i, j, h_mm = map(int, cell.split())
            lowest[j, i] = min(h_mm, lowest.get((j, i), h_mm))
    return ";".join(f"{i} {j} {h_mm}" for (j, i), h_mm in sorted(lowest.items()))
