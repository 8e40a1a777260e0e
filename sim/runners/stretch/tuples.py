"""Numbers of records as tuples, and back, in compiled code."""

from __future__ import annotations

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64
from flightstack.core.numeric import hypot, numeric, twin
from flightstack.core.types import Vec3


@numeric
def _length(x: float, y: float) -> float:
    return hypot(x, y)


length = twin(_length, jitted)


@jitted
def three(v: F64) -> Vec3:
    """Three numbers of an array as a tuple."""
    return (v[0], v[1], v[2])


@jitted
def keep(into: F64, v: Vec3) -> None:
    """Write three numbers."""
    into[0], into[1], into[2] = v[0], v[1], v[2]


@jitted
def five(v: F64) -> tuple[float, float, float, float, float]:
    """Five numbers of an array as a tuple."""
    return (v[0], v[1], v[2], v[3], v[4])


@jitted
def six(v: F64) -> tuple[float, float, float, float, float, float]:
    """Six numbers of an array as a tuple."""
    return (v[0], v[1], v[2], v[3], v[4], v[5])


@jitted
def nine(v: F64) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Nine numbers of an array as a tuple."""
    return (v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8])


@jitted
def thirteen(
    v: F64,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float, float, float]:
    """Thirteen numbers of an array as a tuple."""
    return (v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11], v[12])
