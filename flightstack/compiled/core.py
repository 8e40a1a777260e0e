"""Choice of the code that computes a control step: plain Python, or compiled code if that is possible."""

from __future__ import annotations

from importlib.util import find_spec

from flightstack.common.text import pip_install
from flightstack.compiled.jit import compiling, is_kept, is_off
from flightstack.core.controller import Controller
from flightstack.core.numeric import hypot_is_known
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.parameters.flight import FlightConfig, TouchdownRule


def suits(config: FlightConfig) -> bool:
    """Whether the compiled landing kernel supports all features of a configuration."""
    return config.filter in FILTERS and suits_but_filter(config)


def suits_but_filter(config: FlightConfig) -> bool:
    """Whether the compiled landing kernel supports all features; the filter is not checked."""
    return (
        not config.fleet.others
        and config.velocity_loop.dead_time_s == 0.0  # compiled code has no queue of set-points
        and config.touchdown.rule is TouchdownRule.CONTACT
    )


def chosen_core(core: str, config: FlightConfig, *, lockstep: bool) -> str:
    """Return the code to use, ``plain`` or ``compiled``; ``core``: value of the option ``--core``.

    ``auto``: compiled code in real time if its machine code is on disk, else plain Python. In lockstep,
    loading compiled code takes more time than compiled code saves in one flight.

    Raises ValueError: compiled code is requested but not possible.
    """
    possible, fits = not is_off() and find_spec("numba") is not None, suits(config)
    if core == "compiled" and not possible:
        raise ValueError(
            "--core compiled: numba is not installed, or switched off by NUMBA_DISABLE_JIT; "
            f"{pip_install('sim')}, or leave it out"
        )
    if core == "compiled" and not fits:
        raise ValueError(
            f"--core compiled: found filter {config.filter}; compiled code flies {' and '.join(FILTERS)}, "
            "without [fleet] and velocity_loop.dead_time_s, with touchdown.rule contact: leave it out"
        )
    if core == "auto":
        warm = not lockstep and possible and fits and is_kept(f"core-{config.filter}")
        return "compiled" if warm else "plain"
    return core


def compiled(config: FlightConfig) -> Controller:
    """Return a controller with compiled ticks; if compilation is not possible, a plain ``Controller``."""
    if is_off() or not suits(config) or not hypot_is_known():
        return Controller(config)
    from flightstack.compiled.tick import CompiledController

    with compiling(f"core-{config.filter}", "the controller, about 15 s, once"):
        return CompiledController(config)
