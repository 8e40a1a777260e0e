"""Quadratic program of the control barrier function (paper eq. 11): OSQP solves it, each result is checked.

    min |u - u'|^2   subject to   lower <= u <= upper,   g . u >= -omega h - dh/dt

The program has one barrier row and three box rows; the solver is set up once and updated each tick. It starts
from the exact projection of this tick (``projection.py``), point and multipliers, which its optimality test
confirms immediately; otherwise it iterates. So a result depends only on the numbers of this tick, a log can
be replayed from any tick, and the time is bounded. (From zero the solver takes hundreds of iterations where
the barrier's gradient is nearly the normal of a side of the box and both are active.) A result is used only
if it has the status solved and meets box and barrier; otherwise the exact projection is used. If no point of
the box meets the barrier, the command is the corner of the box that raises h fastest, with its own status.

The solver is used without its Python interface and scipy.sparse, which only store a matrix for it: the import
of these two takes a tenth of a second in each process.
"""

from __future__ import annotations

import math
import struct
import sys
import time
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from flightstack.core.numeric import numeric
from flightstack.core.safety.projection import EMPTY, best_corner, projected
from flightstack.core.types import FilterStatus, Vec3

_NAME = "osqp.ext_builtin"
_SCIPY, _SPARSE = "scipy", "scipy.sparse"


class Columns(NamedTuple):
    """Sparse matrix stored by columns, with the names of ``scipy.sparse.csc_matrix``, which OSQP reads."""

    shape: tuple[int, ...]
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    data: NDArray[np.float64]
    nnz: int


def columns(dense: NDArray[np.float64]) -> Columns:
    """Return a matrix stored by columns, without its zeros."""
    column, row = np.nonzero(dense.T)
    ends = np.concatenate(([0], np.cumsum(np.count_nonzero(dense, axis=0))))
    return Columns(
        dense.shape, ends.astype(np.int32), row.astype(np.int32), dense.T[column, row], int(ends[-1])
    )


@cache
def compiled_solver() -> Any:
    """Return the module ``osqp.ext_builtin``; a later import of ``osqp`` finds the same module."""
    if _NAME in sys.modules:
        return sys.modules[_NAME]
    package = find_spec("osqp")
    found = package and PathFinder.find_spec(_NAME, package.submodule_search_locations)
    if not found or found.loader is None:
        raise ModuleNotFoundError(f"no module {_NAME}: pip install osqp", name=_NAME)
    module = module_from_spec(found)
    sys.modules[_NAME] = module
    found.loader.exec_module(module)
    return module


def matrix(dense: NDArray[np.float64]) -> Any:
    """Return a matrix in the form that the solver reads."""
    solver = compiled_solver()
    if _SPARSE in sys.modules:
        return solver.CSC(sys.modules[_SPARSE].csc_matrix(dense))
    # The solver imports scipy only to check whether a matrix is stored by columns.
    absent = [name for name in (_SCIPY, _SPARSE) if name not in sys.modules]
    sys.modules.update((name, _ByColumns(name)) for name in absent)
    try:
        return solver.CSC(columns(dense))
    finally:
        for name in absent:
            del sys.modules[name]


class _ByColumns(ModuleType):
    """Stand-in for ``scipy.sparse`` that recognises a matrix stored by columns."""

    @staticmethod
    def isspmatrix_csc(matrix: object) -> bool:
        return isinstance(matrix, Columns)


# The first iteration confirmed all of 100,000 random programs of this size.
EPS = 1e-9  # absolute and relative tolerance of the solver's test, m/s
RHO = 1.0
RELAXATION = 1.5
ITERATIONS_MAX = 200  # about 50 us; after that the exact projection is used
_NUMBERS = struct.Struct("=24d")  # changing data of the program, and start values of the solver
RESIDUAL_MAX_M_S = 1e-6  # largest violation of box or barrier by an accepted result


class FilterResult(NamedTuple):
    """Filtered velocity, and the data to check it.

    Attributes:
        velocity_enu_m_s: filtered velocity, always inside the box.
        slack_m_s: g . u + omega h + dh/dt at the command; negative only if INFEASIBLE.
        active: whether the barrier changed the command.
        status: origin of the result.
        residual_m_s: the solver's largest violation before clipping.
        iterations: number of the solver's iterations.
        solve_s: wall time of projection and solver.
    """

    velocity_enu_m_s: Vec3
    slack_m_s: float
    active: bool
    status: FilterStatus
    residual_m_s: float
    iterations: int
    solve_s: float


class Program(Protocol):
    """Program that computes the filtered velocity from the nominal one."""

    def solve(
        self, nominal: Vec3, h_m: float, gradient: Vec3, dh_dt_m_s: float, lower: Vec3, upper: Vec3
    ) -> FilterResult:
        """Filter one nominal velocity; the arguments are those of ``SafetyFilter.solve``."""


def solver_settings(osqp: Any) -> Any:
    """Return solver settings that make a result depend only on the numbers of its tick."""
    settings = osqp.OSQPSettings()
    osqp.osqp_set_default_settings(settings)
    settings.verbose = 0
    settings.eps_abs = settings.eps_rel = EPS
    settings.rho, settings.alpha = RHO, RELAXATION
    settings.adaptive_rho = 0
    settings.scaling = 0  # scaling at each update would add rounding errors of earlier ticks
    settings.max_iter = ITERATIONS_MAX
    settings.check_termination = 1
    return settings


class SafetyFilter:
    """Quadratic program whose memory is allocated once."""

    omega_1_s: float
    enforces: bool  # False: the velocity is only limited to the box

    def __init__(self, omega_1_s: float) -> None:
        osqp = compiled_solver()
        self.omega_1_s, self.enforces = omega_1_s, True
        constraint = matrix(np.vstack([np.ones((1, 3)), np.eye(3)]))
        numbers = np.ones(_NUMBERS.size // 8)
        self._memory = numbers.data
        # data: -u', bounds of the rows, and of A the columns (g_x, 1), (g_y, 1), (g_z, 1);
        # start: point and multipliers
        self._q, self._lower, self._upper = numbers[:3], numbers[3:7], numbers[7:11]
        self._ax, self._x, self._y = numbers[11:17], numbers[17:20], numbers[20:]
        self._lower[:], self._upper[:], self._infinity = -1.0, osqp.OSQP_INFTY, osqp.OSQP_INFTY
        hessian = matrix(np.eye(3))
        self._solver = osqp.OSQPSolver(
            hessian, self._q, constraint, self._lower, self._upper, 4, 3, solver_settings(osqp)
        )
        self._solved = int(osqp.osqp_status_type.OSQP_SOLVED)

    def solve(
        self, nominal: Vec3, h_m: float, gradient: Vec3, dh_dt_m_s: float, lower: Vec3, upper: Vec3
    ) -> FilterResult:
        """Filter one nominal velocity."""
        bound = -self.omega_1_s * h_m - dh_dt_m_s
        gx, gy, gz = gradient
        finite = bound + gx + gy + gz + nominal[0] + nominal[1] + nominal[2] + lower[0] + lower[1] + lower[2]
        if not math.isfinite(finite + upper[0] + upper[1] + upper[2]):
            return FilterResult((0.0, 0.0, 0.0), math.nan, False, FilterStatus.REJECTED, math.nan, 0, 0.0)
        if not self.enforces:
            free, _ = clipped(nominal, gradient, bound, lower, upper)
            return FilterResult(free, 0.0, False, FilterStatus.OWN, 0.0, 0, 0.0)
        corner = best_corner(gradient, lower, upper)
        slack = gx * corner[0] + gy * corner[1] + gz * corner[2] - bound
        if slack < 0.0:
            return FilterResult(corner, slack, True, FilterStatus.INFEASIBLE, 0.0, 0, 0.0)
        started_s = self._time_s()
        exact, multiplier = projected(nominal, gradient, bound, lower, upper)
        if multiplier == EMPTY:  # rounding made the feasible set empty
            multiplier = math.inf
        point, residual, iterations = self._osqp(nominal, gradient, bound, lower, upper, exact, multiplier)
        solve_s = self._time_s() - started_s
        status = FilterStatus.SOLVED
        if residual > RESIDUAL_MAX_M_S or not math.isfinite(residual):
            point, status = exact, FilterStatus.CLOSED_FORM
        slack, active = judged(point, nominal, gradient, bound, lower, upper)
        return FilterResult(point, slack, active, status, residual, iterations, solve_s)

    def _time_s(self) -> float:
        return time.perf_counter()

    def _osqp(
        self, nominal: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3, start: Vec3,
        multiplier: float,
    ) -> tuple[Vec3, float, int]:  # fmt: skip
        """Run OSQP; return the point clipped to the box, its residual (inf if not solved), and iterations.

        The solver starts from the point ``start`` and the multiplier of the barrier there.
        """
        solver = self._solver
        # one copy, since numpy needs the same time for each of three
        numbers = data_and_start(nominal, gradient, bound, lower, upper, self._infinity, start, multiplier)
        _NUMBERS.pack_into(self._memory, 0, *numbers)
        solver.update_data_vec(q=self._q, l=self._lower, u=self._upper)
        solver.update_data_mat(P_x=None, P_i=None, A_x=self._ax, A_i=None)
        solver.warm_start(self._x, self._y)
        solver.solve()
        info = solver.info
        x, y, z = solver.solution.x.tolist()
        point, residual = clipped((x, y, z), gradient, bound, lower, upper)
        if info.status_val != self._solved or not math.isfinite(x + y + z):
            return point, math.inf, info.iter
        return point, residual, info.iter


@numeric
def data_and_start(
    nominal: Vec3,
    gradient: Vec3,
    bound: float,
    lower: Vec3,
    upper: Vec3,
    infinity: float,
    point: Vec3,
    multiplier: float,
) -> tuple[float, ...]:
    """Return the changing numbers of the program, and the point and multipliers where the solver starts.

    The start is optimal if u - u' - multiplier g + y = 0; y are the multipliers of the active box sides.
    """
    multiplier = multiplier if math.isfinite(multiplier) else 0.0
    (nx, ny, nz), (gx, gy, gz), (lx, ly, lz), (hx, hy, hz) = nominal, gradient, lower, upper
    px, py, pz = point
    return (
        -nx, -ny, -nz, bound, lx, ly, lz, infinity, hx, hy, hz, gx, 1.0, gy, 1.0, gz, 1.0, px, py, pz,
        -multiplier, nx + multiplier * gx - px, ny + multiplier * gy - py, nz + multiplier * gz - pz,
    )  # fmt: skip


@numeric
def clipped(point: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3) -> tuple[Vec3, float]:
    """Return a solution clipped to the box, and its largest violation of box or barrier."""
    (x, y, z), (gx, gy, gz), (lx, ly, lz), (hx, hy, hz) = point, gradient, lower, upper
    cx, cy, cz = min(max(x, lx), hx), min(max(y, ly), hy), min(max(z, lz), hz)
    barrier_miss = bound - (gx * cx + gy * cy + gz * cz)
    return (cx, cy, cz), max(abs(x - cx), abs(y - cy), abs(z - cz), barrier_miss, 0.0)


@numeric
def judged(
    point: Vec3, nominal: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3
) -> tuple[float, bool]:
    """Return the slack of the barrier's row at a point, and whether the row rejects the nominal velocity."""
    (x, y, z), (nx, ny, nz), (gx, gy, gz) = point, nominal, gradient
    (lx, ly, lz), (hx, hy, hz) = lower, upper
    free = gx * min(max(nx, lx), hx) + gy * min(max(ny, ly), hy) + gz * min(max(nz, lz), hz)
    return gx * x + gy * y + gz * z - bound, free < bound
