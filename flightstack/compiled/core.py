"""Choice of the code that computes a control step: plain Python, or compiled code if that is possible."""

from __future__ import annotations

from enum import Enum
from importlib.util import find_spec

from flightstack.common.text import pip_install
from flightstack.compiled.jit import is_kept, is_off, keep, telling
from flightstack.core.controller import Controller
from flightstack.core.numeric import hypot_is_known
from flightstack.core.parameters.flight import FlightConfig, TouchdownRule


class Core(Enum):
    """Code that computes a control step; the value is that of the option ``--core``."""

    AUTO = "auto"  # in real time: compiled code if its machine code is on disk, else plain Python
    PLAIN = "plain"
    COMPILED = "compiled"


def is_possible() -> bool:
    """Whether numba is installed and not disabled."""
    return not is_off() and find_spec("numba") is not None


def suits(config: FlightConfig) -> bool:
    """Whether the compiled landing kernel supports all features of a configuration."""
    return config.filter in ("robust", "paper") and suits_but_filter(config)


def suits_but_filter(config: FlightConfig) -> bool:
    """Whether the compiled landing kernel supports all features except, perhaps, the filter."""
    return (
        not config.fleet.others
        and config.velocity_loop.dead_time_s == 0.0  # compiled code has no queue of set-points
        and config.touchdown.rule is TouchdownRule.CONTACT
    )


def _stamp(config: FlightConfig) -> str:
    """Return the name of a file that marks the machine code of this configuration as complete."""
    return f"core-{config.filter}"


def chosen_core(core: Core, config: FlightConfig, *, lockstep: bool) -> Core:
    """Return the code to use: ``PLAIN`` or ``COMPILED``.

    In lockstep the default is plain Python: loading compiled code takes longer than it saves in one flight.

    Raises ValueError: compiled code is requested but not possible.
    """
    if core is Core.COMPILED and not is_possible():
        raise ValueError(
            "--core compiled: numba is not installed, or switched off by NUMBA_DISABLE_JIT; "
            f"{pip_install('sim')}, or leave it out"
        )
    if core is Core.COMPILED and not suits(config):
        raise ValueError(
            f"--core compiled: found filter {config.filter}; compiled code flies robust and paper, without "
            "[fleet] and velocity_loop.dead_time_s, with touchdown.rule contact: leave it out"
        )
    if core is Core.AUTO:
        warm = not lockstep and is_possible() and suits(config) and is_kept(_stamp(config))
        return Core.COMPILED if warm else Core.PLAIN
    return core


def compiled(config: FlightConfig) -> Controller:
    """Return a controller with compiled ticks; if these are not possible, one in plain Python."""
    if is_off() or not suits(config) or not hypot_is_known():
        return Controller(config)
    from flightstack.compiled.tick import CompiledController

    with telling("the controller, about 10 s, once"):
        made = CompiledController(config)
    keep(_stamp(config))
    return made
