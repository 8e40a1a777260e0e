"""Quadratic program of the control barrier function (paper eq. 11): OSQP solves it, each result is checked.

    min |u - u'|^2   subject to   lower <= u <= upper,   g . u >= -omega h - dh/dt     (u': nominal velocity)

The program has one constraint for the barrier and three for the box; the solver is set up once and updated
each tick. The solver starts from the exact projection of this tick (``projection.py``). The solver's
optimality test usually confirms this start immediately; otherwise the solver iterates. Therefore a result
depends only on the data of this tick, and the time is bounded. (From zero the solver needs hundreds of
iterations if the barrier's gradient is nearly normal to a side of the box and both constraints are active.) A
result is used only if it has the status solved and satisfies box and barrier; otherwise the exact projection
is used. If no point of the box satisfies the barrier, the command is the corner of the box that raises h
fastest, with status INFEASIBLE.
"""

from __future__ import annotations

import math
from time import perf_counter
from typing import NamedTuple

from flightstack.core.safety.osqp import Osqp
from flightstack.core.safety.projection import EMPTY, projected
from flightstack.core.types import FilterStatus, Vec3

RESIDUAL_MAX_M_S = 1e-6  # maximum allowed violation of box or barrier by a result, m/s


class FilterResult(NamedTuple):
    """Filtered velocity, and the data to check it."""

    velocity_enu_m_s: Vec3  # filtered velocity, m/s; inside the box if the filter ran
    slack_m_s: float  # slack g . u + omega h + dh/dt of the command, m/s; negative only if INFEASIBLE or OWN
    active: bool  # whether the barrier, or a user's filter, changed the command
    status: FilterStatus  # origin of the result
    residual_m_s: float  # largest violation of box, or of barrier after clipping, in OSQP's result, m/s
    iterations: int  # number of the solver's iterations
    solve_s: float  # wall time of projection and solver, s


class SafetyFilter:
    """Quadratic program whose memory is allocated once."""

    omega_1_s: float
    osqp: Osqp
    enforces: bool  # whether the barrier is enforced; False: only the box limits the velocity

    def __init__(self, omega_1_s: float) -> None:
        self.omega_1_s, self.enforces, self.osqp = omega_1_s, True, Osqp(1)

    def solve(
        self, nominal: Vec3, h_m: float, gradient: Vec3, dh_dt_m_s: float, lower: Vec3, upper: Vec3
    ) -> FilterResult:
        """Return the velocity nearest to ``nominal`` that satisfies barrier and box, with its status."""
        bound = -self.omega_1_s * h_m - dh_dt_m_s
        gx, gy, gz = gradient
        finite = bound + gx + gy + gz + nominal[0] + nominal[1] + nominal[2] + lower[0] + lower[1] + lower[2]
        if not math.isfinite(finite + upper[0] + upper[1] + upper[2]):
            return FilterResult((0.0, 0.0, 0.0), math.nan, False, FilterStatus.REJECTED, math.nan, 0, 0.0)
        if not self.enforces:
            free, _ = clipped(nominal, gradient, bound, lower, upper)
            return FilterResult(free, 0.0, False, FilterStatus.OWN, 0.0, 0, 0.0)
        started_s = perf_counter()
        exact, multiplier = projected(nominal, gradient, bound, lower, upper)
        if multiplier == EMPTY:
            slack = gx * exact[0] + gy * exact[1] + gz * exact[2] - bound
            return FilterResult(exact, slack, True, FilterStatus.INFEASIBLE, 0.0, 0, 0.0)
        point, residual, iterations = self._osqp(nominal, gradient, bound, lower, upper, exact, multiplier)
        solve_s, status = perf_counter() - started_s, FilterStatus.SOLVED
        if not residual <= RESIDUAL_MAX_M_S:
            point, status = exact, FilterStatus.CLOSED_FORM
        slack = gx * point[0] + gy * point[1] + gz * point[2] - bound
        return FilterResult(point, slack, multiplier != 0.0, status, residual, iterations, solve_s)

    def _osqp(
        self, nominal: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3, start: Vec3,
        multiplier: float,
    ) -> tuple[Vec3, float, int]:  # fmt: skip
        """Run OSQP; return the point clipped to the box, its residual (inf if not solved), and iterations.

        The solver starts from the point ``start`` and the multiplier of the barrier there.
        """
        point, solved, iterations = self.osqp.solve(
            data_and_start(nominal, gradient, bound, lower, upper, self.osqp.infinity, start, multiplier)
        )
        point, residual = clipped(point, gradient, bound, lower, upper)
        return point, residual if solved else math.inf, iterations


def data_and_start(
    nominal: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3, infinity: float, point: Vec3,
    multiplier: float,
) -> tuple[float, ...]:  # fmt: skip
    """Return the program's data that change in each tick, and the solver's start point and multipliers.

    The start is optimal if u - u' - multiplier g + y = 0; y are the multipliers of the active box sides.
    """
    multiplier = multiplier if math.isfinite(multiplier) else 0.0
    (nx, ny, nz), (gx, gy, gz), (lx, ly, lz), (hx, hy, hz) = nominal, gradient, lower, upper
    px, py, pz = point
    return (
        -nx, -ny, -nz, bound, lx, ly, lz, infinity, hx, hy, hz, gx, 1.0, gy, 1.0, gz, 1.0, px, py, pz,
        -multiplier, nx + multiplier * gx - px, ny + multiplier * gy - py, nz + multiplier * gz - pz,
    )  # fmt: skip


def clipped(point: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3) -> tuple[Vec3, float]:
    """Return a solution clipped to the box, and its largest violation of box or barrier, m/s."""
    (x, y, z), (gx, gy, gz), (lx, ly, lz), (hx, hy, hz) = point, gradient, lower, upper
    if lx <= x <= hx and ly <= y <= hy and lz <= z <= hz:  # the usual case, with a faster computation
        return point, max(0.0, bound - (gx * x + gy * y + gz * z))
    cx, cy, cz = min(max(x, lx), hx), min(max(y, ly), hy), min(max(z, lz), hz)
    barrier_miss = bound - (gx * cx + gy * cy + gz * cz)
    return (cx, cy, cz), max(abs(x - cx), abs(y - cy), abs(z - cz), barrier_miss, 0.0)
