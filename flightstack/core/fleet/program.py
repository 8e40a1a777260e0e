"""Quadratic program of a fleet member: ``safety/qp_filter.py`` with one more constraint for each neighbour.

OSQP starts from the exact solution (``solution.py``). The result of OSQP is used only if it satisfies all
constraints (``Row``) and equals that solution. If no velocity satisfies all constraints, vehicles with late
messages get constraints without their reachable sets; if this is not enough, the constraints of all
neighbours are relaxed by the smallest common slack. The landing barrier and the velocity limits (box) are
never relaxed.

Over the pad, ``Cone`` first reduces the box. A single vehicle flies inwards, where the boundary is lower; a
vehicle that gives way can fly outwards or past the centre, where the boundary can rise faster than the
vehicle climbs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.fleet.solution import Row, least_slack, nearest
from flightstack.core.parameters.fleet import OTHERS_MAX
from flightstack.core.safety.osqp import Osqp
from flightstack.core.safety.position_loop import clip, clip_to_box
from flightstack.core.safety.projection import best_corner
from flightstack.core.safety.qp_filter import RESIDUAL_MAX_M_S, FilterResult
from flightstack.core.types import ZERO, FilterStatus, Vec3

FIRM_MAX = 2  # maximum number of constraints that are never relaxed
AGREES_M_S = 1e-6  # maximum allowed difference between the solver's result and the exact solution, m/s
_ROWS = FIRM_MAX + OTHERS_MAX
INWARD_RATE_1_S = 2.5  # ratio of allowed horizontal velocity to distance from the pad's centre, 1/s
OUTWARD_PART = 0.5  # fraction of the landing barrier's allowed decay that is available to horizontal motion
RELAXED_M_S = 1e-8  # addition to the smallest slack, m/s, so that the feasible set is more than one point


class FleetResult(NamedTuple):
    """Filtered velocity of a fleet member."""

    # filtered velocity; the slack is that of the landing barrier, NaN if no landing barrier is active
    filter: FilterResult
    given_m_s: float  # slack of the neighbours' constraints, m/s; 0 unless the status is CROWDED


class FleetProgram:
    """Quadratic program of this vehicle and its neighbours."""

    def __init__(self) -> None:
        self._solver = Osqp(_ROWS)

    def solve(
        self, nominal: Vec3, firm: Sequence[Row], neighbours: Sequence[Row], lower: Vec3, upper: Vec3,
        basic: Sequence[Row] = (),
    ) -> FleetResult:  # fmt: skip
        """Return the velocity nearest to ``nominal`` within the constraints; relax ``neighbours`` if needed.

        ``firm``: constraints that are never relaxed, the landing barrier first; ``basic``: constraints of the
        neighbours without the reachable sets of vehicles with late messages.
        """
        every = [*firm, *neighbours]
        (lx, ly, lz), (hx, hy, hz), (x, y, z) = lower, upper, nominal
        sums = lx + ly + lz + hx + hy + hz + x + y + z
        for (gx, gy, gz), bound_m_s in every:
            sums += gx + gy + gz + bound_m_s
        if not math.isfinite(sums):
            idle = FilterResult(ZERO, math.nan, False, FilterStatus.REJECTED, math.nan, 0, 0.0)
            return FleetResult(idle, 0.0)
        started = time.perf_counter()
        landing = firm[0] if firm else None
        corner = best_corner(landing.g, lower, upper) if landing is not None else ZERO
        if landing is not None and (missing_m_s := landing.missing_m_s(corner)) > 0.0:
            result = FilterResult(corner, -missing_m_s, True, FilterStatus.INFEASIBLE, 0.0, 0, 0.0)
            return FleetResult(result, 0.0)
        best, given_m_s = nearest(nominal, every, lower, upper), 0.0
        if best is None and basic and basic != neighbours:
            neighbours, every = basic, [*firm, *basic]
            best = nearest(nominal, every, lower, upper)
        point, residual, iterations, status = corner, 0.0, 0, FilterStatus.CROWDED
        if best is not None:
            point, residual, iterations = self._osqp(nominal, every, lower, upper, *best)
            status = FilterStatus.SOLVED
            if not (residual <= RESIDUAL_MAX_M_S and math.dist(point, best[0]) <= AGREES_M_S):
                point, status = best[0], FilterStatus.CLOSED_FORM
        else:
            given_m_s, point = least_slack(firm, neighbours, lower, upper)
            if math.isfinite(given_m_s):
                less = given_m_s + RELAXED_M_S
                found = nearest(nominal, [*firm, *(Row(g, b - less) for g, b in neighbours)], lower, upper)
                point = found[0] if found is not None else point
            elif landing is not None:  # numerically no other velocity satisfies the landing barrier
                point = corner
        slack = -landing.missing_m_s(point) if landing is not None else math.nan
        active = landing is not None and landing.missing_m_s(clip_to_box(nominal, lower, upper)) > 0.0
        solve_s = time.perf_counter() - started
        result = FilterResult(point, slack, active, status, residual, iterations, solve_s)
        return FleetResult(result, given_m_s)

    def _osqp(
        self, nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3, start: Vec3,
        multipliers: Sequence[float],
    ) -> tuple[Vec3, float, int]:  # fmt: skip
        """Return the OSQP result clipped to the box, its residual (inf if not solved) and the iterations."""
        infinity, unused = self._solver.infinity, [0.0] * (_ROWS - len(rows))
        (nx, ny, nz), (px, py, pz) = nominal, start
        x, y, z = nx - px, ny - py, nz - pz  # negative gradient; after the loop: multipliers of the box
        for ((gx, gy, gz), _), multiplier in zip(rows, multipliers, strict=True):
            x, y, z = x + multiplier * gx, y + multiplier * gy, z + multiplier * gz
        point, solved, iterations = self._solver.solve(
            [
                -nx, -ny, -nz,
                *(max(row.bound_m_s, -infinity) for row in rows), *(-infinity for _ in unused), *lower,
                *[infinity] * _ROWS, *upper,
                *(row.g[0] for row in rows), *unused, 1.0,
                *(row.g[1] for row in rows), *unused, 1.0,
                *(row.g[2] for row in rows), *unused, 1.0,
                px, py, pz,
                *(-each for each in multipliers), *unused, x, y, z,
            ]
        )  # fmt: skip
        kept = clip_to_box(point, lower, upper)
        if not solved:
            return kept, math.inf, iterations
        return kept, max([math.dist(kept, point), *(row.missing_m_s(kept) for row in rows)]), iterations


class Cone(NamedTuple):
    """Limits of this vehicle's velocity over the pad."""

    rate_1_s: float  # omega of paper eq. 11, 1/s: maximum allowed decay rate of h
    slope_max: float  # steepest slope of the safe set's boundary
    lag_s: float  # time until a climb command takes effect, s
    period_s: float  # period of a tick, s

    def outward(self, h_m: float, gradient: Vec3, before_m_s: Vec3, target_m_s: Vec3) -> Row:
        """Return the constraint that limits the growth of outward velocity, so that a climb can restore h.

        The constraint always allows a stop of an inward motion.
        """
        gx, gy, _ = gradient
        used_m_s = self.period_s * self.rate_1_s * max(0.0, h_m) / self.lag_s
        with_target = gx * target_m_s[0] + gy * target_m_s[1]
        inward_m_s = gx * before_m_s[0] + gy * before_m_s[1] - with_target
        return Row((gx, gy, 0.0), with_target + min(0.0, inward_m_s) - OUTWARD_PART * used_m_s)

    def box(
        self, d_m: float, h_m: float, nominal: Vec3, target_m_s: Vec3, lower: Vec3, upper: Vec3
    ) -> tuple[Vec3, Vec3]:
        """Return limits with which the avoidance adds no sink rate and does not cross the pad's centre fast.

        Beyond the centre an inward velocity becomes an outward one. A stop of a climb is always allowed. The
        sink rate relative to the pad is at most ``rate_1_s`` times h. An inward path, where the boundary
        falls, would allow more, but a neighbour can reverse this motion before a climb takes effect.
        """
        most = INWARD_RATE_1_S * d_m + OUTWARD_PART * max(0.0, h_m) / (self.slope_max * self.lag_s)
        (tx, ty, tz), (lx, ly, lz), (ux, uy, uz) = target_m_s, lower, upper
        least_z_m_s = min(tz, max(nominal[2], tz - self.rate_1_s * max(0.0, h_m)))
        return (
            (clip(tx - most, lx, ux), clip(ty - most, ly, uy), clip(least_z_m_s, lz, uz)),
            (clip(tx + most, lx, ux), clip(ty + most, ly, uy), uz),
        )
