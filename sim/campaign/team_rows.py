"""The row of a team in a campaign: of each value the worst of the members'."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from logs.schema.names import member_name
from logs.verdict.types import Outcome
from logs.verdict.verdict import FleetVerdict, any_known, fleet_verdict, least
from sim.campaign.rows import Row, vehicle_row
from sim.runners.landing import TeamLanding


def judge_team(flown: TeamLanding) -> FleetVerdict:
    """Judge a team as the log of a fleet is judged."""
    names = {number: member_name(number) for number in range(1, len(flown.landings) + 1)}
    members = {names[n]: landing.verdict for n, landing in enumerate(flown.landings, 1)}
    return fleet_verdict(members, flown.pairs, names)


def row_of(flown: TeamLanding) -> Row:
    """Make the row of a team: sums of retries and of times in the phases, of everything else the worst.

    Of one vehicle it has no values of a team.
    """
    if len(flown.landings) == 1:
        return vehicle_row(flown.landings[0])
    verdict = judge_team(flown)
    rows = [vehicle_row(landing) for landing in flown.landings]
    deepest = min(rows, key=lambda row: _or(row.h_min_outside_pad_m, float("inf")))
    all_landed = verdict.outcome is Outcome.LANDED
    return Row(
        seed=flown.seed,
        outcome=verdict.outcome.value,
        reason=verdict.reason,
        violation=any_known(row.violation for row in rows),
        started_safe=_all(row.started_safe for row in rows),
        h_min_m=least(row.h_min_m for row in rows),
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
        wait_max_s=max(flown.waits_s, default=None),
    )


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _sum(rows: Sequence[Row], value: Callable[[Row], float | None]) -> float:
    return sum(_or(value(row), 0.0) for row in rows)


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
