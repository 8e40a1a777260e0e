"""Touchdown as the vehicle's own estimate shows it: when the pad stopped the descent, where, and how fast.

An estimate holds no contacts. What shows one is the descent: low over the pad, the sink rate relative to the
pad collapses within some hundredths of a second, by more than a vehicle in flight can brake in that time.
Position and velocity at the contact are taken from the steps before it, by a straight line through them:
the steps after it already hold the impact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flightstack.core.parameters.ends import Contact, Touchdown
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import packaged_strategy_of
from flightstack.core.types import Phase
from logs.reader.flight_data import Floats, Ints, Steps

BEFORE_S = 0.3  # s before phase TOUCHDOWN: a gust may press the vehicle onto the pad while it still waits
AFTER_S = 1.0  # s after it: with the paper's rule the vehicle falls the last centimetres
MEMORY_S = 0.15  # s over which the sink rate before a contact is known
STOPPED_SHARE = 0.5  # of the sink rate before (median): below it the descent was stopped
STAYS_S = 0.05  # s for which it stays so on average; a noisy sample does not
SINK_MIN_M_S = 0.05  # m/s; a slower descent does not show where it ended
BEGINS_SHARE = 0.85  # of the highest sink rate then: the last step above it was before the contact
FALL_S = 0.06  # s in which the sink rate falls to that share
FIT_S = 0.05  # s before the contact through which the line is laid
HEIGHT_ERROR_MAX_M = 0.05  # m: of both estimates together, beyond the gap that the configuration allows for
_SAME_S = 1e-6  # below the resolution of a tick


@dataclass(frozen=True, slots=True)
class EstimatedTouchdown:
    """First contact with the pad, by the estimate.

    Attributes:
        t_s: time of it, s.
        index: of the first step that is not before it.
        e_m: (3,) position relative to the pad's centre, ENU, m.
        velocity_m_s: (3,) velocity relative to the pad's, ENU, m/s; NaN where the contact itself does not
            show and only the motors that stopped say that it stood.
    """

    t_s: float
    index: int
    e_m: Floats
    velocity_m_s: Floats

    @property
    def d_m(self) -> float:
        """Horizontal distance to the pad's centre, m."""
        return float(np.hypot(self.e_m[0], self.e_m[1]))


def find_touchdown(steps: Steps, config: FlightConfig | None, begin: int) -> EstimatedTouchdown | None:
    """Find the first contact with the pad.

    Args:
        steps: controller steps.
        config: what was flown with; ``None`` takes the defaults, a Crazyflie's.
        begin: index of the step at which the judging begins.

    Returns:
        ``None`` if the estimate shows none and the controller saw none.
    """
    height_max_m = _height_max_m(config)
    for first, last in _runs(steps.phase, begin):
        landed = last + 1 < len(steps.t_s) and steps.phase[last + 1] == Phase.LANDED
        t0_s, t1_s = steps.t_s[first] - BEFORE_S, steps.t_s[last] + (AFTER_S if landed else 0.0)
        span = slice(
            max(begin, int(np.searchsorted(steps.t_s, t0_s - _SAME_S))),
            int(np.searchsorted(steps.t_s, t1_s + _SAME_S)),
        )
        found = _stopped(steps, span, height_max_m)
        if found is not None:
            return _at(steps, begin, found)
        if landed:
            unknown = np.full(3, np.nan)
            return EstimatedTouchdown(float(steps.t_s[last + 1]), last + 1, steps.e_m[last + 1], unknown)
    return None


def feet_and_gap_m(config: FlightConfig | None) -> tuple[float, float]:
    """Height of the reference point above the feet, and the gap below the feet that still is contact, m.

    ``None`` takes the defaults, a Crazyflie's.
    """
    touchdown = config.touchdown if config is not None else Touchdown()
    contact = config.contact if config is not None else Contact()
    return touchdown.feet_below_reference_m, contact.gap_m


def _height_max_m(config: FlightConfig | None) -> float:
    """Height of the reference above the pad below which a contact may be; higher it is braking in flight."""
    height_m = sum(feet_and_gap_m(config)) + HEIGHT_ERROR_MAX_M
    strategy = packaged_strategy_of(config) if config is not None else None
    return max(height_m, strategy.stopped_below_m) if strategy is not None else height_m


def _runs(phase: Ints, begin: int) -> list[tuple[int, int]]:
    """First and last index of each stretch in phase TOUCHDOWN."""
    inside = np.concatenate(([False], phase[begin:] == Phase.TOUCHDOWN, [False]))
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    return [(begin + int(a), begin + int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _stopped(steps: Steps, span: slice, height_max_m: float) -> int | None:
    """Index of the last step before the pad stopped the descent; ``None`` if nothing did."""
    t_s, sink_m_s = steps.t_s[span], -steps.relative_velocity_m_s[span, 2]
    for at in np.flatnonzero(steps.e_m[span, 2] <= height_max_m):
        before = _within(t_s, sink_m_s, t_s[at] - MEMORY_S, t_s[at])
        after = _within(t_s, sink_m_s, t_s[at], t_s[at] + STAYS_S)
        if not len(before) or not len(after):
            continue
        told_m_s = float(np.median(before))
        limit_m_s = STOPPED_SHARE * told_m_s
        if told_m_s < SINK_MIN_M_S or not (sink_m_s[at] < limit_m_s and after.mean() < limit_m_s):
            continue
        last = int(np.searchsorted(t_s, t_s[at] - FALL_S))
        fall = sink_m_s[last:at]
        quick = np.flatnonzero(fall >= BEGINS_SHARE * np.nanmax(fall, initial=0.0))
        return span.start + last + int(quick[-1]) if len(quick) else None
    return None


def _within(t_s: Floats, values: Floats, begin_s: float, end_s: float) -> Floats:
    """Numbers among the values in [begin, end)."""
    part = values[np.searchsorted(t_s, begin_s - _SAME_S) : np.searchsorted(t_s, end_s - _SAME_S)]
    return np.asarray(part[np.isfinite(part)])


def _at(steps: Steps, begin: int, last: int) -> EstimatedTouchdown:
    """Position and velocity at the contact, halfway between the last step before it and the next.

    An estimated velocity is late by about half a step or more: its line ends at the next step.
    """
    t_s, next_s = 0.5 * float(steps.t_s[last] + steps.t_s[last + 1]), float(steps.t_s[last + 1])
    first = max(begin, int(np.searchsorted(steps.t_s, t_s - FIT_S)))
    before = slice(first, last + 1)
    return EstimatedTouchdown(
        t_s,
        last + 1,
        _at_zero(steps.t_s[before] - t_s, steps.e_m[before]),
        _at_zero(steps.t_s[before] - next_s, steps.relative_velocity_m_s[before]),
    )


def _at_zero(t_s: Floats, values: Floats) -> Floats:
    """(k,) the least-squares line through (n, k) values at time 0; NaN with fewer than 3 known rows."""
    known = np.isfinite(values).all(axis=1)
    if known.sum() < 3:
        return np.full(values.shape[1], np.nan)
    return np.asarray(np.polynomial.polynomial.polyfit(t_s[known], values[known], 1)[0])
