"""Proven bounds: the largest value of a function over an interval, and the ranges of a barrier's derivatives.

Samples can miss the worst point. This module bounds a function from above over a whole interval. ``Shape``
gives exact ranges of slope and curvature: their terms are monotone between known points. The interval with
the largest bound is halved until no bound exceeds the largest computed value by more than ``TOLERANCE``.
Intervals can be unbounded.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from flightstack.core.safety.barrier import Barrier

TOLERANCE = 1e-4  # allowed excess of a bound over the maximum, in the unit of the value: m/s, m/s^2 or mm
PIECES_MAX = 20_000  # maximum number of intervals, 100 times the usual number; the bound then still holds
EQUAL = 1e-9  # difference below which two values count as equal
ROUNDING = 1e-12  # assumed relative rounding error; that of a dozen operations is below 3e-15


class Span(NamedTuple):
    """Closed interval; ``high`` can be infinite."""

    low: float
    high: float

    def middle(self) -> float:
        """Return the point that halves the interval; for an unbounded one, a point beyond its lower end."""
        return 2.0 * self.low + 1.0 if math.isinf(self.high) else 0.5 * (self.low + self.high)


def wider(low: float, high: float) -> Span:
    """Return the interval from ``low`` to ``high``, widened by the rounding errors of both values."""
    return Span(low - ROUNDING * (1.0 + abs(low)), high + ROUNDING * (1.0 + abs(high)))


class Most(NamedTuple):
    """Result of ``most``: the function is at most ``bound``; its largest computed value is at ``at``."""

    bound: float
    at: float


def most(function: Callable[[Span], float], domain: Span, likely: tuple[float, ...] = ()) -> Most:
    """Bound a function from above over an interval.

    ``function``: upper bound in an interval; for an interval of one point, the value itself. ``likely``:
    points to evaluate first. Of points with equal values the first is returned. Raises ValueError: the
    function is not a number somewhere.
    """
    ends = domain if math.isfinite(domain.high) else (domain.low,)
    points = [*likely, domain.middle(), *ends]
    best, best_at = -math.inf, points[0]
    heap = [(-function(domain), 0, domain)]
    for number in range(1, PIECES_MAX):
        for at in points:
            if (value := function(Span(at, at))) > best + EQUAL:
                best, best_at = value, at
        if math.isnan(heap[0][0]):
            raise ValueError(f"the bound is not a number near {best_at}: a parameter is out of any range")
        if -heap[0][0] - best <= TOLERANCE:
            break
        low, high = heapq.heappop(heap)[2]
        cut = Span(low, high).middle()
        halves = Span(low, cut), Span(cut, high)
        points = [halves[0].middle(), cut, halves[1].middle()]
        for side, half in enumerate(halves):
            heapq.heappush(heap, (-function(half), 2 * number + 1 - side, half))
    return Most(max(best, -heap[0][0]), best_at)


@dataclass(frozen=True, slots=True)
class Shape:
    """Boundary of the safe set, with a margin of any value in a range."""

    barrier: Barrier  # the paper's boundary
    margin_m: Span  # range of the margin far from the pad, m
    fade_radius_m: float  # radius w within which the margin fades, m

    def slope(self, d: Span) -> Span:
        """Return the range of the boundary's slope over distances ``d``, m."""
        w = self.fade_radius_m
        return self._with_margin(
            _range(self.barrier.slope, d, 2.0 / self.barrier.alpha_1_m),
            _range(lambda x: _fade_slope(x, w), d, w / math.sqrt(2.0)),
        )

    def curvature_1_m(self, d: Span) -> Span:
        """Return the range of the slope's derivative, 1/m: the curvature for a radial motion."""
        a, beta_m, w = self.barrier.alpha_1_m, self.barrier.beta_m, self.fade_radius_m

        def bend(x: float) -> float:
            return a * a * beta_m * (a * x - 2.0) * math.exp(-a * x)

        def fade_bend(x: float) -> float:
            q = (x / w) ** 2
            return 2.0 / (w * w) * (1.0 - 2.0 * q) * math.exp(-q)

        return self._with_margin(_range(bend, d, 3.0 / a), _range(fade_bend, d, w * math.sqrt(1.5)))

    def turn_1_m(self, d: Span) -> float:
        """Return the largest curvature for a tangential motion, slope/d, 1/m.

        The result holds for all distances ``d`` and is never below 0. If the slopes b' (boundary) and f'
        (fading factor of the margin) are positive, b'/d and f'/d are largest at the near end.
        """
        near = d.low
        if near <= 0.0:
            return math.inf
        fade = _fade_slope(near, self.fade_radius_m) * self.margin_m.high
        return wider(0.0, max(0.0, self.barrier.slope(near)) / near + fade / near).high

    def _with_margin(self, bare: Span, fading: Span) -> Span:
        """Return the range of a boundary's derivative plus the margin times its factor ``fading``."""
        products = [margin_m * factor for margin_m in self.margin_m for factor in fading]
        margin = wider(min(products), max(products))
        return Span(bare.low + margin.low, bare.high + margin.high)


def _fade_slope(d_m: float, w_m: float) -> float:
    return 2.0 * d_m / (w_m * w_m) * math.exp(-((d_m / w_m) ** 2))


def _range(function: Callable[[float], float], d: Span, extreme: float) -> Span:
    """Return the range of a function that has one extreme on d >= 0 and approaches 0 at infinity."""
    values = [function(d.low), 0.0 if math.isinf(d.high) else function(d.high)]
    if d.low < extreme < d.high:
        values.append(function(extreme))
    return wider(min(values), max(values))
