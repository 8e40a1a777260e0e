"""Access to OSQP's solver without its Python interface and scipy.sparse, which only store a matrix for it.

The import of these two takes a tenth of a second in each process with a solver.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
