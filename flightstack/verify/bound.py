"""Proven bounds: the largest value of a function over a box, and the ranges of a barrier's derivatives.

Samples can miss the worst point. This module bounds a function over any cell from above, with the exact
ranges of its monotone pieces (``Shape``: slope and curvature). The cell with the largest bound is halved
until no bound exceeds the largest computed value by more than ``TOLERANCE``. Cells may reach to infinity.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from flightstack.core.safety.barrier import Barrier

TOLERANCE = 1e-4  # allowed excess of a bound over the maximum, in the unit of the value: m/s, m/s^2 or mm
CELLS_MAX = 20_000  # maximum number of cells, 100 times the usual one; the bound is valid at this number, too
EQUAL = 1e-9  # difference below which two values count as equal
ROUNDING = 1e-12  # assumed relative rounding error; that of a dozen operations is below 3e-15


class Span(NamedTuple):
    """Closed interval; ``high`` may be infinite."""

    low: float
    high: float

    def middle(self) -> float:
        """Return the point that halves the interval; for an unbounded one, a multiple of its lower end."""
        if math.isinf(self.high):
            return 2.0 * self.low + 1.0
        return 0.5 * (self.low + self.high)

    def width(self) -> float:
        """Return the length; it is infinite for an unbounded interval."""
        return self.high - self.low


def wider(span: Span) -> Span:
    """Return the span, widened by the rounding errors of its computation."""
    return Span(span.low - ROUNDING * (1.0 + abs(span.low)), span.high + ROUNDING * (1.0 + abs(span.high)))


class Most(NamedTuple):
    """Result of ``most``: the function is at most ``bound``, and equals ``found`` at the point ``at``."""

    bound: float
    found: float
    at: tuple[float, ...]


def most(
    upper: Callable[[Cell], float], value: Callable[[tuple[float, ...]], float], domain: Cell,
    likely: tuple[tuple[float, ...], ...] = (),
) -> Most:  # fmt: skip
    """Bound a function from above over a box.

    ``upper``: upper bound of the function in a cell; ``value``: the function at a point with finite
    coordinates; ``domain``: the box, one span per coordinate; ``likely``: points to evaluate first. Of points
    with equal values the first is returned. Raises ValueError: the function is not a number somewhere.
    """

    def point(cell: Cell) -> tuple[float, ...]:
        return tuple(span.middle() for span in cell)

    best, best_at = -math.inf, point(domain)
    for start in (*likely, best_at, *_corners(domain)):
        found = value(start)
        if found > best + EQUAL:
            best, best_at = found, start
    heap = [(-upper(domain), 0, domain)]
    for number in range(1, CELLS_MAX):
        bound = -heap[0][0]
        if math.isnan(bound) or math.isnan(best):
            raise ValueError(f"the bound is not a number near {best_at}: a parameter is out of any range")
        if bound - best <= TOLERANCE:
            break
        _, _, cell = heapq.heappop(heap)
        widest = max(range(len(cell)), key=lambda i: _weight(cell[i], domain[i]))
        span = cell[widest]
        cut = span.middle()
        for part in (Span(span.low, cut), Span(cut, span.high)):
            piece = (*cell[:widest], part, *cell[widest + 1 :])
            centre = point(piece)
            for at in (centre, (*centre[:widest], cut, *centre[widest + 1 :])):
                found = value(at)
                if found > best + EQUAL:
                    best, best_at = found, at
            heapq.heappush(heap, (-upper(piece), 2 * number + (part.low == cut), piece))
    return Most(max(best, -heap[0][0]), best, best_at)


def _weight(span: Span, whole: Span) -> float:
    """Return the fraction of the coordinate's range that the cell covers; unbounded cells come first."""
    if math.isinf(span.high):
        return math.inf
    return span.width() / (whole.width() if math.isfinite(whole.high) else 1.0)


def _corners(domain: Cell) -> list[tuple[float, ...]]:
    """Return the corners of a box that have finite coordinates."""
    points: list[tuple[float, ...]] = [()]
    for span in domain:
        ends = (span.low, span.high) if math.isfinite(span.high) else (span.low,)
        points = [(*p, end) for p in points for end in ends]
    return points


@dataclass(frozen=True, slots=True)
class Shape:
    """Boundary of the safe set, with a margin that may have any value of a range."""

    barrier: Barrier  # the paper's boundary
    margin_m: Span  # smallest and largest margin m
    fade_radius_m: float  # radius w within which the margin fades

    def slope(self, d: Span) -> Span:
        """Return the range of the boundary's slope over distances ``d``, m."""
        return _sum(_range(self.barrier.slope, d, 2.0 / self.barrier.alpha_1_m), self._fade_slope(d))

    def curvature_1_m(self, d: Span) -> Span:
        """Return the range of the slope's derivative, 1/m: the curvature for a radial motion."""
        return _sum(_range(self._bend_1_m, d, 3.0 / self.barrier.alpha_1_m), self._fade_curvature_1_m(d))

    def turn_1_m(self, d: Span) -> float:
        """Return the largest slope/d, 1/m, at least 0: the curvature for a tangential motion.

        If b'/d and f'/d are positive, they fall with d, so they are largest at the near end.
        """
        near = d.low
        if near <= 0.0:
            return math.inf
        fade = _fade_slope(near, self.fade_radius_m) * self.margin_m.high
        return wider(Span(0.0, max(0.0, self.barrier.slope(near)) / near + fade / near)).high

    def _bend_1_m(self, d_m: float) -> float:
        a = self.barrier.alpha_1_m
        return a * a * self.barrier.beta_m * (a * d_m - 2.0) * math.exp(-a * d_m)

    def _fade_slope(self, d: Span) -> Span:
        w = self.fade_radius_m
        return _times(self.margin_m, _range(lambda x: _fade_slope(x, w), d, w / math.sqrt(2.0)))

    def _fade_curvature_1_m(self, d: Span) -> Span:
        w = self.fade_radius_m

        def bend(x: float) -> float:
            q = (x / w) ** 2
            return 2.0 / (w * w) * (1.0 - 2.0 * q) * math.exp(-q)

        return _times(self.margin_m, _range(bend, d, w * math.sqrt(1.5)))


def _fade_slope(d_m: float, w_m: float) -> float:
    return 2.0 * d_m / (w_m * w_m) * math.exp(-((d_m / w_m) ** 2))


def _range(function: Callable[[float], float], d: Span, extreme: float) -> Span:
    """Return the range of a function that has one extreme on d >= 0 and approaches 0 at infinity."""
    values = [function(d.low), 0.0 if math.isinf(d.high) else function(d.high)]
    if d.low < extreme < d.high:
        values.append(function(extreme))
    return wider(Span(min(values), max(values)))


def _sum(a: Span, b: Span) -> Span:
    return Span(a.low + b.low, a.high + b.high)


def _times(a: Span, b: Span) -> Span:
    products = [x * y for x in a for y in b]
    return wider(Span(min(products), max(products)))


Cell = tuple[Span, ...]
