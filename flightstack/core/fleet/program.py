"""The program with the rows of neighbours: landing barrier, box, and one row for each neighbour in reach.

The program of ``safety/qp_filter.py`` with more rows. OSQP starts from the exact solution (``dual.py``; if
not confirmed, ``exact.py`` by all active sets), and its result is used only if it meets all rows and equals
that point. If no point meets all rows, the rows of silent vehicles are relaxed first; then all rows of
neighbours together by the least common slack. Landing barrier and box are never relaxed.

Over the pad ``Cone`` cuts the box first. A lone vehicle flies inwards, where the boundary falls; one that
gives way may fly outwards or past the middle, where the boundary may rise faster than it can climb.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flightstack.core.fleet import dual, exact
from flightstack.core.fleet.exact import Nearest, Row
from flightstack.core.parameters.fleet import OTHERS_MAX
from flightstack.core.safety.position_loop import clip, clip_to_box
from flightstack.core.safety.projection import best_corner
from flightstack.core.safety.qp_filter import RESIDUAL_MAX_M_S, FilterResult, solver_settings
from flightstack.core.safety.solver import compiled_solver, matrix
from flightstack.core.types import ZERO, FilterStatus, Vec3

FIRM_MAX = 2  # rows that are never relaxed
AGREES_M_S = 1e-6  # largest distance of the solver's point from the exact one, m/s
_ROWS = FIRM_MAX + OTHERS_MAX
INWARD_RATE_1_S = 2.5  # always allowed horizontal velocity per distance from the pad's middle
OUTWARD_PART = 0.5  # share of the landing barrier's rate for horizontal velocities that lower h
RELAXED_M_S = 1e-8  # added to the least slack, so that the feasible set is more than one point


class FleetResult(NamedTuple):
    """Filtered velocity."""

    # result as that of ``SafetyFilter``; its slack is that of the landing barrier, NaN without one
    filter: FilterResult
    given_m_s: float  # slack of the neighbours' rows; 0 unless CROWDED


def nearest(nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3) -> Nearest | None:
    """Minimiser of the program; ``None`` if no point of the box meets all rows."""
    x, y, z = point = clip_to_box(nominal, lower, upper)
    for (gx, gy, gz), bound_m_s in rows:
        if gx * x + gy * y + gz * z < bound_m_s:
            break
    else:
        return Nearest(point, (0.0,) * len(rows))
    found = dual.solve(nominal, rows, lower, upper)
    if found is None:
        return exact.nearest(nominal, rows, lower, upper)
    return None if found.point is None else Nearest(found.point, found.multipliers)


def least_slack(firm: Sequence[Row], soft: Sequence[Row], lower: Vec3, upper: Vec3) -> tuple[float, Vec3]:
    """Return the least common slack of the soft rows and its velocity, as ``exact.least_slack`` does."""
    return dual.least_slack(firm, soft, lower, upper) or exact.least_slack(firm, soft, lower, upper)


class FleetProgram:
    """The quadratic program, allocated once."""

    def __init__(self, neighbours: int = OTHERS_MAX) -> None:
        exact.prepare(neighbours)
        osqp = compiled_solver()
        size, self._infinite, self._used = _ROWS + 3, float(osqp.OSQP_INFTY), _ROWS
        self._q, self._x, self._y = np.zeros(3), np.zeros(3), np.zeros(size)
        self._lower, self._upper = np.full(size, -self._infinite), np.full(size, self._infinite)
        whole = np.vstack([np.ones((_ROWS, 3)), np.eye(3)])
        self._ax = np.ones(3 * (_ROWS + 1))  # column-wise: all rows of an axis, then its side of the box
        # the same numbers as Python floats: a third of the time of numpy's
        self._numbers: list[Any] = [
            each.data for each in (self._q, self._lower, self._upper, self._x, self._y)
        ]
        self._columns: list[Any] = [each.data for each in self._ax.reshape(3, _ROWS + 1)]
        constraint, hessian = matrix(whole), matrix(np.eye(3))
        self._solver = osqp.OSQPSolver(
            hessian, self._q, constraint, self._lower, self._upper, size, 3, solver_settings(osqp)
        )
        self._solved = osqp.osqp_status_type.OSQP_SOLVED

    def solve(
        self,
        nominal: Vec3,
        firm: Sequence[Row],
        neighbours: Sequence[Row],
        lower: Vec3,
        upper: Vec3,
        lax: Sequence[Row] = (),
    ) -> FleetResult:
        """Filter one nominal velocity."""
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
        if best is None and lax and lax != neighbours:
            neighbours, every = lax, [*firm, *lax]
            best = nearest(nominal, every, lower, upper)
        point, residual, iterations, status = corner, 0.0, 0, FilterStatus.CROWDED
        if best is not None:
            point, residual, iterations = self._osqp(nominal, every, lower, upper, best)
            status = FilterStatus.SOLVED
            if not (residual <= RESIDUAL_MAX_M_S and math.dist(point, best.point) <= AGREES_M_S):
                point, status = best.point, FilterStatus.CLOSED_FORM
        else:
            given_m_s, point = least_slack(firm, neighbours, lower, upper)
            if not math.isfinite(given_m_s):  # only the corner meets the barrier
                point = corner
            else:
                less = given_m_s + RELAXED_M_S
                found = nearest(nominal, [*firm, *(Row(g, b - less) for g, b in neighbours)], lower, upper)
                point = found.point if found is not None else point
        slack = -landing.missing_m_s(point) if landing is not None else math.nan
        active = landing is not None and landing.missing_m_s(clip_to_box(nominal, lower, upper)) > 0.0
        solve_s = time.perf_counter() - started
        result = FilterResult(point, slack, active, status, residual, iterations, solve_s)
        return FleetResult(result, given_m_s)

    def _osqp(
        self, nominal: Vec3, rows: Sequence[Row], lower: Vec3, upper: Vec3, start: Nearest
    ) -> tuple[Vec3, float, int]:
        """Point clipped to the box, its largest violation before (inf if not solved), iterations."""
        q, low, high, first, dual = self._numbers
        in_x, in_y, in_z = self._columns
        (x, y, z), (px, py, pz), count, least = nominal, start.point, len(rows), -self._infinite
        q[0], q[1], q[2] = -x, -y, -z
        first[0], first[1], first[2] = px, py, pz
        x, y, z = x - px, y - py, z - pz  # the part of the sides of the box
        for k, (((gx, gy, gz), bound_m_s), multiplier) in enumerate(
            zip(rows, start.multipliers, strict=True)
        ):
            low[k] = bound_m_s if bound_m_s > least else least
            in_x[k], in_y[k], in_z[k], dual[k] = gx, gy, gz, -multiplier
            x, y, z = x + multiplier * gx, y + multiplier * gy, z + multiplier * gz
        for k in range(count, self._used):
            low[k] = least
            in_x[k] = in_y[k] = in_z[k] = dual[k] = 0.0
        self._used = count
        dual[_ROWS], dual[_ROWS + 1], dual[_ROWS + 2] = x, y, z
        low[_ROWS], low[_ROWS + 1], low[_ROWS + 2] = lower
        high[_ROWS], high[_ROWS + 1], high[_ROWS + 2] = upper
        solver = self._solver
        solver.update_data_vec(q=self._q, l=self._lower, u=self._upper)
        solver.update_data_mat(P_x=None, P_i=None, A_x=self._ax, A_i=None)
        solver.warm_start(self._x, self._y)
        solver.solve()
        info = solver.info
        x, y, z = solver.solution.x.tolist()
        point = clip_to_box((x, y, z), lower, upper)
        if info.status_val != self._solved or not math.isfinite(x + y + z):
            return point, math.inf, info.iter
        residual = math.dist(point, (x, y, z))
        for row in rows:
            missing_m_s = row.missing_m_s(point)
            residual = missing_m_s if missing_m_s > residual else residual
        return point, residual, info.iter


class Cone(NamedTuple):
    """Bounds of the velocity over the pad."""

    rate_1_s: float  # rate at which h may be used up
    slope_max: float  # steepest slope of the boundary
    lag_s: float  # delay of a climb
    period_s: float  # period of a tick

    def outward(self, h_m: float, gradient: Vec3, before_m_s: Vec3, target_m_s: Vec3) -> Row:
        """Row that lets a velocity out of the cone grow no faster than the climb that holds h can follow.

        Flying inwards may always end.
        """
        gx, gy, _ = gradient
        used_m_s = self.period_s * self.rate_1_s * max(0.0, h_m) / self.lag_s
        with_target = gx * target_m_s[0] + gy * target_m_s[1]
        inward_m_s = gx * before_m_s[0] + gy * before_m_s[1] - with_target
        return Row((gx, gy, 0.0), with_target + min(0.0, inward_m_s) - OUTWARD_PART * used_m_s)

    def box(
        self, d_m: float, h_m: float, nominal: Vec3, target_m_s: Vec3, lower: Vec3, upper: Vec3
    ) -> tuple[Vec3, Vec3]:
        """Box in which avoidance neither adds sink rate nor carries the vehicle fast across the middle.

        Beyond the middle an inward velocity becomes an outward one. A climb may always end. The vehicle
        sinks no faster than h alone allows: on an inward path, where the boundary falls, a neighbour may
        reverse the vehicle sooner than the climb follows.
        """
        most = INWARD_RATE_1_S * d_m + OUTWARD_PART * max(0.0, h_m) / (self.slope_max * self.lag_s)
        (tx, ty, tz), (lx, ly, lz), (ux, uy, uz) = target_m_s, lower, upper
        least_z_m_s = min(tz, max(nominal[2], tz - self.rate_1_s * max(0.0, h_m)))
        return (
            (
                clip(tx - most, lx, ux),
                clip(ty - most, ly, uy),
                clip(least_z_m_s, lz, uz),
            ),
            (clip(tx + most, lx, ux), clip(ty + most, ly, uy), uz),
        )
