"""Functions of numbers in the core that a simulator may compile: one source, equal to the last bit.

Such a function takes and returns floats and tuples of floats, and calls nothing but others of them and
``sqrt`` of ``math``. Compiled code agrees with Python to the last bit on these and on + - * /; it need not on
``hypot``, ``remainder``, ``expm1``, ``**``, nor on ``max`` and ``min`` of zeros.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

MARKED: list[Callable[..., Any]] = []  # as they are written


def numeric(function: F) -> F:
    """Mark a function of a module as one that may be compiled; it stays as it is until then."""
    MARKED.append(function)
    return function


def compile_with(compiler: Callable[[Any], Any]) -> None:
    """From now on the names of the marked functions stand for compiled ones; done again, it changes nothing.

    Args:
        compiler: turns a function into one that is compiled when it is first called.
    """
    for function in MARKED:
        module = sys.modules[function.__module__]
        if getattr(module, function.__name__) is function:
            setattr(module, function.__name__, compiler(function))
