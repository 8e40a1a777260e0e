"""Support for functions of the core that are also compiled; both forms agree to the last bit.

Compiled functions take and return numbers, tuples of numbers, and objects of the core. They call functions of
this project, ``exp``, ``expm1`` and ``sqrt`` of ``math``, and ``hypot`` and ``wrapped`` of this module. The
results of these functions and of + - * / are the same in compiled code and Python, to the last bit; those of
``math.hypot``, ``math.remainder`` and ``**`` can differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dis import get_instructions
from functools import cache
from time import perf_counter
from types import FunctionType
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])
Vec3 = tuple[float, float, float]

C = TypeVar("C", bound=type)
MARKED: set[type] = set()
RARE: set[Callable[..., Any]] = set()
_OURS = ("flightstack.", "bridge.", "sim.")  # prefixes of the modules whose functions are compiled
# functions of ``math`` whose machine code differs in the last bits
_INEXACT = {"hypot", "dist", "remainder", "fsum", "pow"}
_SPLIT = 134217729.0  # factor 2^27 + 1, which splits a double into two halves (Veltkamp)


def numeric(cls: C) -> C:
    """Mark a named tuple whose methods compiled code can call."""
    MARKED.add(cls)
    return cls


def rare(function: F) -> F:
    """Mark a function that only Python runs: in compiled code, its call raises ``NotOrdinary``."""
    RARE.add(function)
    return function


UNSEEN = "unseen"  # annotation of fields that do not exist in compiled code


class NotOrdinary(Exception):  # noqa: N818
    """Compiled code cannot compute this tick: restore the state, and run the tick in Python."""


@cache
def twin(function: F, compiler: Callable[[Any], Any]) -> F:
    """Compile a function and the functions that it calls; the plain functions remain unchanged."""
    return cast(F, compiler(scope_of(function, compiler)))


def scope_of(function: Callable[..., Any], compiler: Callable[[Any], Any]) -> FunctionType:
    """Copy a function, and replace each function of this project that it calls by its compiled form."""
    own = cast("FunctionType", function)
    scope = dict(own.__globals__)
    used = (each for each in get_instructions(own) if each.opname in ("LOAD_ATTR", "LOAD_METHOD"))
    if found := _INEXACT & {each.argval for each in used}:
        raise ValueError(f"{own.__qualname__}: {', '.join(sorted(found))}: machine code has other last bits")
    for name in own.__code__.co_names:
        one = scope.get(name)
        one = STAND_INS.get(one, one) if callable(one) else one
        if isinstance(one, FunctionType) and one.__module__.startswith(_OURS):
            scope[name] = twin(one, compiler)
    copy = FunctionType(own.__code__, scope, own.__name__, own.__defaults__)
    copy.__qualname__, copy.__module__ = own.__qualname__, own.__module__
    return copy


hypot = math.hypot


def norm(v: Vec3) -> float:
    """Return the length of a vector."""
    return math.hypot(*v)


def wrapped(angle_rad: float) -> float:
    """Wrap an angle to [-pi, pi]; the compiled form accepts at most one and a half turns."""
    return math.remainder(angle_rad, math.tau)


def _length(v: tuple[float, ...]) -> float:
    """Compute ``math.hypot`` of finite numbers as CPython 3.11 does (mathmodule.c, vector_norm)."""
    most = 0.0
    for x in v:
        most = max(most, abs(x))
    if most == 0.0:
        return 0.0
    _, exponent = math.frexp(most)
    whole, high, cross, low = 1.0, 0.0, 0.0, 0.0
    if exponent < -1023:  # the power of two below would overflow
        for x in v:
            term, before = (x / most) * (x / most), whole
            whole += term
            high += (before - whole) + term
        return most * math.sqrt(whole - 1.0 + high)
    scale = math.ldexp(1.0, -exponent)
    for x in v:
        y = abs(x) * scale
        t = y * _SPLIT
        hi = t - (t - y)
        lo = y - hi
        term, before = hi * hi, whole
        whole += term
        high += (before - whole) + term
        term, before = 2.0 * hi * lo, whole
        whole += term
        cross += (before - whole) + term
        low += lo * lo
    root = math.sqrt(whole - 1.0 + (high + cross + low))
    t = root * _SPLIT
    hi = t - (t - root)
    lo = root - hi
    term, before = -hi * hi, whole
    whole += term
    high += (before - whole) + term
    term, before = -2.0 * hi * lo, whole
    whole += term
    cross += (before - whole) + term
    term, before = -lo * lo, whole
    whole += term
    low += (before - whole) + term
    return (root + (whole - 1.0 + (high + cross + low)) / (2.0 * root)) / scale


def _hypot(x: float, y: float) -> float:
    return _length((x, y))


def _wrapped(angle_rad: float) -> float:
    """Wrap an angle of at most one and a half turns, so that the subtraction is exact; NaN if larger."""
    if abs(angle_rad) <= math.pi:
        return angle_rad
    if not abs(angle_rad) <= 1.5 * math.tau:
        return math.nan
    return angle_rad - math.copysign(math.tau, angle_rad)


def _no_time() -> float:
    """Return 0, because compiled code has no clock; the caller measures the time of a tick."""
    return 0.0


@cache
def hypot_is_known() -> bool:
    """Whether ``math.hypot`` of this Python equals ``_hypot`` for some thousand pairs of numbers."""
    numbers = [math.ldexp(math.sin(k), k % 37 - 30) for k in range(1, 80)]
    return all(_hypot(x, y) == math.hypot(x, y) for x in numbers for y in numbers)


# functions that compiled code uses in place of those that cannot be compiled, or differ in the last bits
STAND_INS: dict[Callable[..., Any], Callable[..., Any]] = {
    math.hypot: _hypot,
    norm: _length,
    wrapped: _wrapped,
    perf_counter: _no_time,
}
