"""OSQP's compiled module loaded directly, and matrices in its format."""

import subprocess
import sys

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import sparse

from flightstack.core.safety.solver import columns

_VALUES = st.sampled_from([0.0, 1.0, -2.5])


@given(arrays(np.float64, array_shapes(min_dims=2, max_dims=2, max_side=6), elements=_VALUES))
def test_columns_are_those_of_scipy(dense):
    ours, theirs = columns(dense), sparse.csc_matrix(dense)
    assert ours.shape == theirs.shape
    assert ours.nnz == theirs.nnz
    for name in ("indptr", "indices", "data"):
        mine, its = getattr(ours, name), getattr(theirs, name)
        assert mine.dtype == its.dtype
        assert np.array_equal(mine, its)


def test_a_process_that_solves_loads_no_scipy_and_osqp_finds_the_same_module():
    code = (
        "import sys; from flightstack.core.controller import Controller;"
        "from flightstack.core.fleet.program import FleetProgram;"
        "from flightstack.config.files import load;"
        "from flightstack.core.safety.solver import compiled_solver;"
        "Controller(load('crazyflie')); FleetProgram();"
        "assert not {'scipy', 'scipy.sparse', 'jinja2', 'osqp'} & sys.modules.keys();"
        "import scipy.sparse; assert scipy.sparse.csr_matrix;"
        "import osqp; from osqp import ext_builtin; assert ext_builtin is compiled_solver()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
