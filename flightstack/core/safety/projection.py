"""Exact projection onto a box cut by one half-space: the closed form of the landing quadratic program.

    min |u - u'|^2   subject to   lower <= u <= upper,   g . u >= b     (u': nominal velocity)

The minimiser is ``clip(u' + lambda g)`` with the smallest multiplier lambda >= 0 that satisfies the
half-space. g . clip(u' + lambda g) never falls with lambda, and is linear between the values of lambda at
which an axis reaches its bound, so a walk over these values finds lambda exactly. The solver shares no code
with this module; in flight the solver starts from this result and confirms or improves it.
"""

from __future__ import annotations

import math

from flightstack.core.numeric import STAND_INS
from flightstack.core.types import Vec3


def best_corner(g: Vec3, lower: Vec3, upper: Vec3) -> Vec3:
    """Return the point of the box with the largest ``g . u``; where g is 0, the value nearest to zero."""
    return (
        upper[0] if g[0] > 0.0 else lower[0] if g[0] < 0.0 else min(max(0.0, lower[0]), upper[0]),
        upper[1] if g[1] > 0.0 else lower[1] if g[1] < 0.0 else min(max(0.0, lower[1]), upper[1]),
        upper[2] if g[2] > 0.0 else lower[2] if g[2] < 0.0 else min(max(0.0, lower[2]), upper[2]),
    )


EMPTY = -1.0  # value of the multiplier if no point of the box is in the half-space


def projected(nominal: Vec3, g: Vec3, b: float, lower: Vec3, upper: Vec3) -> tuple[Vec3, float]:
    """Return the minimiser and the multiplier lambda of the half-space.

    Lambda is 0 if the half-space is inactive, infinite if no finite value satisfies the half-space, and
    ``EMPTY`` (with the best corner) if no point of the box satisfies it.
    """
    (nx, ny, nz), (lx, ly, lz), (hx, hy, hz) = nominal, lower, upper
    x, y, z = min(max(nx, lx), hx), min(max(ny, ly), hy), min(max(nz, lz), hz)
    value = g[0] * x + g[1] * y + g[2] * z
    if value >= b:
        return (x, y, z), 0.0
    corner = best_corner(g, lower, upper)
    if g[0] * corner[0] + g[1] * corner[1] + g[2] * corner[2] < b:
        return corner, EMPTY
    multiplier = _multiplier(nominal, g, b, lower, upper, value)
    if not math.isfinite(multiplier):
        return corner, math.inf
    x, y, z = nx + multiplier * g[0], ny + multiplier * g[1], nz + multiplier * g[2]
    return (min(max(x, lx), hx), min(max(y, ly), hy), min(max(z, lz), hz)), multiplier


def _multiplier(nominal: Vec3, g: Vec3, b: float, lower: Vec3, upper: Vec3, value: float) -> float:
    """Return the lambda that satisfies the half-space; ``value`` is ``g . u`` at lambda = 0, below ``b``."""
    # values of lambda at which a component of u leaves its near bound (starts to change) and reaches its far
    # bound (stops)
    events: list[tuple[float, float]] = []
    slope = 0.0
    for axis in range(3):
        n, gi, lo, hi = nominal[axis], g[axis], lower[axis], upper[axis]
        if gi == 0.0:
            continue
        near, far = (lo, hi) if gi > 0.0 else (hi, lo)
        start, stop = (near - n) / gi, (far - n) / gi
        if stop <= 0.0:
            continue
        if start > 0.0:
            events.append((start, gi * gi))
        else:
            slope += gi * gi
        events.append((stop, -gi * gi))
    _sort(events)
    at = 0.0
    for when, change in events:
        if slope > 0.0 and value + slope * (when - at) >= b:
            break
        value += slope * (when - at)
        at = when
        slope += change
    return at + (b - value) / slope if slope > 0.0 else at


def _sort(events: list[tuple[float, float]]) -> None:
    events.sort()


def _sort_by_insertion(events: list[tuple[float, float]]) -> None:
    for first in range(1, len(events)):
        for n in range(first, 0, -1):
            if events[n] < events[n - 1]:
                events[n], events[n - 1] = events[n - 1], events[n]


STAND_INS[_sort] = _sort_by_insertion  # numba needs 2 s to compile ``list.sort``
