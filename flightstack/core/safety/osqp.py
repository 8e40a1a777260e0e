"""OSQP, called through addresses of its C functions, so that Python and compiled code use the same solver.

    min |u - u'|^2   subject to   lower <= u <= upper,   g_k . u >= b_k     (u': nominal velocity)

The module ``osqp.ext_builtin`` is loaded without the package ``osqp``, whose import takes a tenth of a
second. The memory offsets belong to the release that ``pyproject.toml`` names; to check them, each new solver
first solves a program with a known solution.
"""

from __future__ import annotations

import ctypes
import math
import struct
import sys
from collections.abc import Sequence
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from typing import Any

import numpy as np

from flightstack.core.types import Vec3

_NAME = "osqp.ext_builtin"
DOUBLE = 8  # size of a double, bytes
_STATUS_AT, _ITERATIONS_AT = 32, 80  # byte offsets in OSQPInfo (osqp_api_types.h)
# With this tolerance the first iteration confirmed all of 100,000 random programs with one constraint.
EPS = 1e-9  # absolute (m/s) and relative tolerance of the solver's test
RHO = 1.0
RELAXATION = 1.5
ITERATIONS_MAX = 200  # maximum number of iterations (about 50 us); then the exact solution is used
_KNOWN: Vec3 = (0.25, -0.5, 0.125)  # nominal velocity within all limits, so that it is the solution


class _Csc(ctypes.Structure):
    """C struct OSQPCscMatrix: a sparse matrix stored by columns."""

    _fields_ = (
        ("m", ctypes.c_int), ("n", ctypes.c_int), ("p", ctypes.c_void_p), ("i", ctypes.c_void_p),
        ("x", ctypes.c_void_p), ("nzmax", ctypes.c_int), ("nz", ctypes.c_int), ("owned", ctypes.c_int),
    )  # fmt: skip


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


@cache
def _library() -> ctypes.PyDLL:
    return ctypes.PyDLL(compiled_solver().__file__)


def _settings() -> Any:
    """Return solver settings with which a result depends only on the data of the current tick."""
    osqp = compiled_solver()
    settings = osqp.OSQPSettings()
    osqp.osqp_set_default_settings(settings)
    settings.eps_abs = settings.eps_rel = EPS
    settings.rho, settings.alpha = RHO, RELAXATION
    settings.max_iter, settings.check_termination = ITERATIONS_MAX, 1
    settings.verbose = settings.adaptive_rho = 0
    settings.scaling = 0  # scaling would carry rounding errors of earlier ticks into the current tick
    return settings


class Osqp:
    """Solver of a program with ``rows`` constraints and a box; its memory is allocated once.

    ``numbers``: -u', the lower and upper bounds of constraints and box, the columns of their matrix (for each
    axis the constraints' gradients, then 1 for the box), and start point and start multipliers.
    """

    # addresses of the C functions, of the solver, and of the arrays that it reads and writes
    update_vectors: int
    update_matrix: int
    warm_start: int
    run: int
    solver: int
    numbers: int
    solution: int
    status: int
    iterations: int
    rows: int  # number of constraints
    solved: int  # OSQP's status value for "solved"
    infinity: float  # OSQP's value for "no bound"

    def __init__(self, rows: int) -> None:
        osqp, settings = compiled_solver(), _settings()
        library, sides = _library(), rows + 3
        self.rows, self.infinity = rows, float(osqp.OSQP_INFTY)
        self.solved = int(osqp.osqp_status_type.OSQP_SOLVED)
        nothing = [-self.infinity] * rows
        first = [
            *(-each for each in _KNOWN), *nothing, -1.0, -1.0, -1.0, *[self.infinity] * rows, 1.0, 1.0, 1.0,
            *[1.0] * (3 * rows + 3), *_KNOWN, *[0.0] * sides,
        ]  # fmt: skip
        numbers = np.array(first)
        ends, units = np.arange(4, dtype=np.int32), np.ones(3)
        places = np.array([[*range(rows), rows + axis] for axis in range(3)], dtype=np.int32)
        columns = (rows + 1) * ends
        self.numbers = at = numbers.ctypes.data
        bounds, gradients = at + 3 * DOUBLE, at + (3 + 2 * sides) * DOUBLE
        hessian = _Csc(3, 3, ends.ctypes.data, ends.ctypes.data, units.ctypes.data, 3, -1, 0)
        matrix = _Csc(sides, 3, columns.ctypes.data, places.ctypes.data, gradients, 3 * (rows + 1), -1, 0)
        solver, whole, pointer = ctypes.c_void_p(), ctypes.c_int, ctypes.c_void_p
        failed = library.osqp_setup(
            ctypes.byref(solver), ctypes.byref(hessian), pointer(at), ctypes.byref(matrix), pointer(bounds),
            pointer(bounds + sides * DOUBLE), whole(sides), whole(3), pointer(_inside(settings)),
        )  # fmt: skip
        if failed or solver.value is None:
            raise RuntimeError(f"OSQP rejects a program with {rows} constraints: error {failed}")
        self._cleanup, self._made, self.solver = library.osqp_cleanup, solver, solver.value
        self._owned = (settings, numbers, ends, units, places, columns)  # memory that the solver uses
        _, solution, info, _ = (ctypes.c_int64 * 4).from_address(self.solver)  # four pointers of OSQPSolver
        self.status, self.iterations = info + _STATUS_AT, info + _ITERATIONS_AT
        self.solution = ctypes.c_int64.from_address(solution).value
        names = ("update_data_vec", "update_data_mat", "warm_start", "solve")
        functions = [getattr(library, f"osqp_{name}") for name in names]
        self.update_vectors, self.update_matrix, self.warm_start, self.run = (
            ctypes.cast(function, pointer).value or 0 for function in functions
        )
        # C functions and arguments for calls from plain Python
        self._calls = [
            (function, tuple(pointer(each) for each in given))
            for function, given in zip(functions, calls(rows, self.solver, at), strict=True)
        ]
        self._pack, self._memory = struct.Struct(f"={len(first)}d").pack_into, numbers.data
        self._point = (ctypes.c_double * 3).from_address(self.solution)
        self._status, self._count = whole.from_address(self.status), whole.from_address(self.iterations)
        point, solved, iterations = self.solve(first)
        if not (solved and 0 < iterations <= ITERATIONS_MAX and math.dist(point, _KNOWN) <= EPS):
            raise RuntimeError("this OSQP has another memory layout: install the release of pyproject.toml")

    def __del__(self) -> None:
        if hasattr(self, "_made"):
            self._cleanup(self._made)

    def solve(self, numbers: Sequence[float]) -> tuple[Vec3, bool, int]:
        """Solve a program; return the point, whether OSQP reports it as solved, and the iterations."""
        self._pack(self._memory, 0, *numbers)
        for function, given in self._calls:
            function(*given)
        x, y, z = self._point
        return (x, y, z), self._status.value == self.solved and math.isfinite(x + y + z), self._count.value


def calls(rows: int, solver: int, numbers: int) -> tuple[tuple[int, ...], ...]:
    """Return the arguments of the four C functions that solve a program, in the order of their calls."""
    bounds, sides, at = 3, rows + 3, DOUBLE
    gradients = bounds + 2 * sides
    start = gradients + 3 * rows + 3
    return (
        (solver, numbers, numbers + bounds * at, numbers + (bounds + sides) * at),
        (solver, 0, 0, 0, numbers + gradients * at, 0, 3 * rows + 3),
        (solver, numbers + start * at, numbers + (start + 3) * at),
        (solver,),
    )


def _inside(one: Any) -> int:
    """Return the address of the C++ object of a pybind11 object, which stores it after the header."""
    return int(ctypes.c_void_p.from_address(id(one) + object.__basicsize__).value or 0)
