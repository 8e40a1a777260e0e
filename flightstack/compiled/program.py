"""Program of ``SafetyFilter`` for compiled code, which calls OSQP's solver directly."""

from __future__ import annotations

import ctypes
import time
from functools import cache
from typing import Any, ClassVar, cast

import numpy as np

from flightstack.compiled.foreign import ask, doubles, whole
from flightstack.compiled.jit import forbid_compiling, jitted
from flightstack.compiled.objects import Objects
from flightstack.core.safety.qp_filter import (
    Columns,
    FilterResult,
    SafetyFilter,
    clipped,
    columns,
    compiled_solver,
    data_and_start,
    solver_settings,
)
from flightstack.core.types import FilterStatus, Vec3

NUMBERS = 24  # number of values of ``data_and_start``
_STATUS_AT, _ITERATIONS_AT = 32, 80  # byte offsets in OSQPInfo (osqp_api_types.h)
_DOUBLE = 8  # bytes of a double


class _Csc(ctypes.Structure):
    """C struct OSQPCscMatrix."""

    _fields_ = (
        ("m", ctypes.c_int), ("n", ctypes.c_int), ("p", ctypes.c_void_p), ("i", ctypes.c_void_p),
        ("x", ctypes.c_void_p), ("nzmax", ctypes.c_int), ("nz", ctypes.c_int), ("owned", ctypes.c_int),
    )  # fmt: skip


def _held(one: Any) -> int:
    """Return the address of the C++ object in an object of pybind11: it follows Python's object header."""
    return int(ctypes.c_void_p.from_address(id(one) + object.__basicsize__).value or 0)


def _csc(m: Columns) -> _Csc:
    places = (m.indptr.ctypes.data, m.indices.ctypes.data, m.data.ctypes.data)
    return _Csc(m.shape[0], m.shape[1], *places, m.nnz, -1, 0)


def _osqp(
    one: CompiledFilter, nominal: Vec3, gradient: Vec3, bound: float, lower: Vec3, upper: Vec3, start: Vec3,
    multiplier: float,
) -> tuple[Vec3, float, int]:  # fmt: skip
    """Compiled form of ``SafetyFilter._osqp``."""
    given = data_and_start(nominal, gradient, bound, lower, upper, one.infinity, start, multiplier)
    numbers, at, solver = doubles(one.numbers), one.numbers, one.solver
    for i in range(NUMBERS):
        numbers[i] = given[i]
    ask(one.update_vectors, (solver, at, at + 3 * _DOUBLE, at + 7 * _DOUBLE))
    ask(one.update_matrix, (solver, 0, 0, 0, at + 11 * _DOUBLE, 0, 6))
    ask(one.warm_start, (solver, at + 17 * _DOUBLE, at + 20 * _DOUBLE))
    ask(one.run, (solver,))
    found, iterations = doubles(one.solution), whole(one.iterations) + 0
    point = (found[0], found[1], found[2])
    if whole(one.status) != one.solved or not np.isfinite(point[0] + point[1] + point[2]):
        return point, np.inf, iterations
    point, residual = clipped(point, gradient, bound, lower, upper)
    return point, residual, iterations


def _no_time_s(_one: CompiledFilter) -> float:
    return 0.0


@jitted
def _answered(one: SafetyFilter, *given: Any) -> FilterResult:
    return one.solve(*given)


class CompiledFilter(SafetyFilter):
    """``SafetyFilter`` as one call of compiled code, which is compiled or loaded when an instance is made.

    Compiled code uses ``solve`` of ``SafetyFilter``, and calls OSQP by the addresses of its functions.
    """

    compiled: ClassVar = {"solve": SafetyFilter.solve, "_osqp": _osqp, "_time_s": _no_time_s}
    # addresses of OSQP's functions, of its solver, and of the numbers that it reads and writes
    update_vectors: int
    update_matrix: int
    warm_start: int
    run: int
    solver: int
    numbers: int
    solution: int
    status: int
    iterations: int
    solved: int  # status of a program that is solved
    infinity: float

    def __init__(self, plain: SafetyFilter) -> None:
        self.omega_1_s, self.enforces, self._plain = plain.omega_1_s, plain.enforces, plain
        osqp = compiled_solver()
        library, settings, numbers = ctypes.CDLL(osqp.__file__), solver_settings(osqp), np.ones(NUMBERS)
        hessian, constraint = columns(np.eye(3)), columns(np.vstack([np.ones((1, 3)), np.eye(3)]))
        self._kept = (settings, hessian, constraint, numbers)  # the solver uses the memory of these objects
        numbers[3:7], numbers[7:11], self.infinity = -1.0, osqp.OSQP_INFTY, osqp.OSQP_INFTY
        self.numbers = at = numbers.ctypes.data
        p, a, solver = _csc(hessian), _csc(constraint), ctypes.c_void_p()
        failed = library.osqp_setup(
            ctypes.byref(solver), ctypes.byref(p), ctypes.c_void_p(at), ctypes.byref(a),
            ctypes.c_void_p(at + 3 * _DOUBLE), ctypes.c_void_p(at + 7 * _DOUBLE), 4, 3,
            ctypes.c_void_p(_held(settings)),
        )  # fmt: skip
        if failed or solver.value is None:
            raise RuntimeError(f"OSQP refuses the landing's program: error {failed}")
        self._cleanup, self.solver = library.osqp_cleanup, solver.value
        _, solution, info, _ = (ctypes.c_int64 * 4).from_address(self.solver)  # OSQPSolver: pointers
        self.status, self.iterations = info + _STATUS_AT, info + _ITERATIONS_AT
        self.solution = ctypes.c_int64.from_address(solution).value
        self.update_vectors, self.update_matrix, self.warm_start, self.run = (
            ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
            for name in ("osqp_update_data_vec", "osqp_update_data_mat", "osqp_warm_start", "osqp_solve")
        )
        self.solved = int(osqp.osqp_status_type.OSQP_SOLVED)
        self._objects = Objects(self)
        self._handle, self._answered = self._objects.handle, cast("Any", _answered)
        low, high = (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)
        self._answered(self._handle, (0.0, 0.0, 0.0), 0.1, (0.1, 0.2, 1.0), 0.0, low, high)
        forbid_compiling(_answered)

    def __del__(self) -> None:
        if getattr(self, "solver", None):
            self._cleanup(ctypes.c_void_p(self.solver))

    def solve(
        self, nominal: Vec3, h_m: float, gradient: Vec3, dh_dt_m_s: float, lower: Vec3, upper: Vec3
    ) -> FilterResult:
        """Filter one nominal velocity; the arguments are those of ``SafetyFilter.solve``."""
        given, started_s = (nominal, h_m, gradient, dh_dt_m_s, lower, upper), time.perf_counter()
        try:
            result: FilterResult = self._answered(self._handle, *given)
        except TypeError:  # numbers of a type for which nothing is compiled
            return self._plain.solve(*given)
        if result.iterations:
            result = result._replace(solve_s=time.perf_counter() - started_s)
        return result


@cache
def layout_is_known() -> bool:
    """Whether the memory layout of this OSQP is as assumed: results then equal those of ``SafetyFilter``."""
    plain = SafetyFilter(1.0)
    made = CompiledFilter(plain)
    for k in range(1, 9):
        nominal, g, side = (0.3 * k - 1.0, 0.2, -0.1 * k), (0.1 * k, -0.5, 1.0), 0.25 * k
        given = nominal, 0.1 * k - 0.4, g, 0.05, (-side, -side, -side), (side, side, side)
        expected, found = (each.solve(*given)._replace(solve_s=0.0) for each in (plain, made))
        if expected.status is not FilterStatus.SOLVED or found != expected:
            return False  # OSQP solves all eight; a skipped program would prove nothing
    return True
