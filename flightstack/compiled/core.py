"""The controller with compiled parts: the filter's program, and the long functions of numbers of the core.

Its set-points, states and rows of the log are those of plain Python to the last bit; a replay in plain Python
shows that of each flight. Nothing is compiled while it flies: numbers of a kind that was not compiled for, of
which none is known, are computed by Python.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from enum import Enum
from importlib.util import find_spec
from typing import Any

from flightstack.compiled.jit import F, forbid_compiling, is_kept, is_off, jitted, keep, telling
from flightstack.core.controller import Controller
from flightstack.core.numeric import CALLED, STAND_INS, twin
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.target.estimator import TargetEstimator

_STAMP = "core"  # file in the folder of machine code: all of the core's is there
_SAMPLES = (((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), 0.7), ((0.2, 0.3, 0.4), (0.4, 0.5, 0.6), 0.8))


class Core(Enum):
    """Which code computes a control step; the value is that of ``--core``."""

    AUTO = "auto"  # compiled in real time where the machine code is there
    PLAIN = "plain"
    COMPILED = "compiled"


def is_possible() -> bool:
    """Whether numba is installed, and not switched off."""
    return not is_off() and find_spec("numba") is not None


def is_warm() -> bool:
    """Whether the machine code is on disk, so that it is loaded in tenths of a second."""
    return is_kept(_STAMP)


def chosen_core(core: Core, *, lockstep: bool) -> Core:
    """What is flown: ``PLAIN`` or ``COMPILED``.

    In lockstep, loading takes longer than is won in a flight.

    Raises ValueError: compiled code is asked for and not possible.
    """
    if core is Core.COMPILED and not is_possible():
        raise ValueError(
            "--core compiled: numba is not installed, or switched off by NUMBA_DISABLE_JIT; "
            "pip install 'crazyflie-flightstack[sim]', or leave it out"
        )
    if core is Core.AUTO:
        return Core.COMPILED if not lockstep and is_possible() and is_warm() else Core.PLAIN
    return core


def compile_core(config: FlightConfig) -> None:
    """Compile the core, or load its machine code; in this process it is compiled from then on."""
    own = [(f, sys.modules[f.__module__]) for f in CALLED]
    own = [(f, module) for f, module in own if getattr(module, f.__name__) is f]
    for function, module in own:
        setattr(module, function.__name__, twin(function, _apart))
    with telling():
        _exercise(config)
    for function, module in own:
        either = _or_python(twin(function, _apart), function)
        STAND_INS[either] = function
        setattr(module, function.__name__, either)
    keep(_STAMP)


def _exercise(config: FlightConfig) -> None:
    """Call everything that is compiled."""
    with_compiled_program(Controller(config))
    estimator = TargetEstimator(config.target)
    for n, (position, velocity, yaw) in enumerate(_SAMPLES):
        estimator.update(0.05 * n, position, velocity, yaw)
    estimator.at(0.1)


def _apart(function: F) -> F:
    """Compile a separate form: the simulator's batches share one and may compile it for more types."""
    return jitted(function)


def _or_python(machine: Callable[..., Any], plain: Callable[..., Any]) -> Callable[..., Any]:
    """Compiled function for the argument types compiled so far; all other types run in Python."""
    forbid_compiling(machine)

    def call(*arguments: Any) -> Any:
        try:
            return machine(*arguments)
        except TypeError:  # argument types that are not compiled
            return plain(*arguments)

    return call


def compiled(config: FlightConfig) -> Controller:
    """Make a controller with compiled parts; see ``compile_core``."""
    compile_core(config)
    return with_compiled_program(Controller(config))


def with_compiled_program(controller: Controller) -> Controller:
    """Give a controller the compiled form of its program, if there is one; return it."""
    program = controller.program
    if type(program) is SafetyFilter and not is_off():
        from flightstack.compiled.program import CompiledFilter, layout_is_known

        if layout_is_known():
            controller.program = CompiledFilter(program)
    return controller
