"""Exact ranges of the boundary's slope and curvature over an interval of distance.

The boundary that the robust filter holds is ``b(d) + m f(d)``, b the paper's and ``f = 1 - exp(-(d/w)^2)``.
Each derivative is made of pieces whose extremes are known, so a range over an interval is its ends and the
extremes inside; no sample is needed. m = 0 is the paper's boundary.

    b'  = alpha beta (1 - alpha d) exp(-alpha d)          lowest at 2/alpha
    b'' = alpha^2 beta (alpha d - 2) exp(-alpha d)        highest at 3/alpha
    f'  = 2 d/w^2 exp(-(d/w)^2)                           highest at w/sqrt(2)
    f'' = 2/w^2 (1 - 2 (d/w)^2) exp(-(d/w)^2)             lowest at w sqrt(3/2)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from flightstack.core.safety.barrier import Barrier
from flightstack.verify.bound import Span, wider


@dataclass(frozen=True, slots=True)
class Shape:
    """The boundary with any margin of a range.

    Attributes:
        barrier: the paper's boundary.
        margin_m: smallest and largest margin m.
        fade_radius_m: w above.
    """

    barrier: Barrier
    margin_m: Span
    fade_radius_m: float

    def slope(self, d: Span) -> Span:
        """Range of the boundary's slope over distances ``d``, m."""
        return _sum(_range(self.barrier.slope, d, 2.0 / self.barrier.alpha_1_m), self._fade_slope(d))

    def curvature_1_m(self, d: Span) -> Span:
        """Range of the slope's derivative, 1/m: the curvature for a radial motion."""
        return _sum(_range(self._bend_1_m, d, 3.0 / self.barrier.alpha_1_m), self._fade_curvature_1_m(d))

    def turn_1_m(self, d: Span) -> float:
        """Largest slope/d, 1/m, at least 0: the curvature for a tangential motion.

        Where they are positive, b'/d and f'/d fall with d, so the near end has the largest.
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
    """Range of a function with one extreme on d >= 0 that goes to 0 at infinity."""
    values = [function(d.low), 0.0 if math.isinf(d.high) else function(d.high)]
    if d.low < extreme < d.high:
        values.append(function(extreme))
    return wider(Span(min(values), max(values)))


def _sum(a: Span, b: Span) -> Span:
    return Span(a.low + b.low, a.high + b.high)


def _times(a: Span, b: Span) -> Span:
    products = [x * y for x in a for y in b]
    return wider(Span(min(products), max(products)))
