"""Judges a flight by the vehicle's own estimate, if the log has no true states. Definitions: ``verdict.py``.

An estimate has no contacts. The first contact is found from the descent: low over the pad, the sink rate
relative to the pad falls to almost zero within a few hundredths of a second, faster than a vehicle in flight
can brake. Position and velocity at the contact come from a straight line through the steps before the
contact: later steps already include the impact. Phase LANDED means that the motors have stopped. A crash that
the stack did not notice looks like a timeout; the reason of the verdict says so. The numbers are as accurate
as the estimates of vehicle and target: a constant error of either estimate is not visible.

An autopilot with its own physics may have a floor but no pad (``Flight.pad_carries``): the vehicle then lands
on the floor at the pad's height and remains there while the target moves on. Such a flight is judged until
the contact, and must rest in the world instead of on the pad.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.core.parameters.flight import Contact, FlightConfig, Touchdown
from flightstack.core.strategies.strategy import packaged_strategy_of
from flightstack.core.types import Phase
from logs.reader.flight_data import Flight, Floats, Ints, Steps
from logs.verdict.types import (
    ESTIMATE,
    GAP_MAX_S,
    REST_TIME_S,
    Outcome,
    Touch,
    Verdict,
    abort_declared,
    judged_until,
    measured,
    never_began,
)

REST_SPEED_MAX_M_S = 0.10  # maximum estimated speed relative to the pad at rest, m/s; estimates are noisy
REST_HEIGHT_MAX_M = 0.05  # maximum distance of feet and pad beyond the contact gap, m; estimates drift
# maximum time between the check at rest and the nearest valid state, s; at rest the states, rounded to mm,
# repeat, and repeated states are marked invalid
REST_SEEN_S = 0.5
_SAME_S = 1e-6  # tolerance of equal times, s; much shorter than a tick
BEFORE_S = 0.3  # searched time before phase TOUCHDOWN, s: a gust may press the vehicle onto the pad earlier
AFTER_S = 1.0  # searched time after phase TOUCHDOWN, s: with the paper's rule the last centimetres are a fall
MEMORY_S = 0.15  # time before a stop from which the sink rate of the descent is computed, s
STOPPED_SHARE = 0.5  # fraction of the earlier median sink rate; below this fraction the descent has stopped
# interval after a stop, s; the mean sink rate there must also be below STOPPED_SHARE times the earlier median
STAYS_S = 0.05
SINK_MIN_M_S = 0.05  # minimum sink rate of a descent whose end can be detected, m/s
# Fraction of the highest sink rate; the last step above this rate was before the contact. A lower fraction
# includes steps of a lagging state (lag 0.03 s, 50 Hz: contact 0.10 m/s too slow with 0.85, 0.03 at 0.95).
BEGINS_SHARE = 0.95
# median absolute second difference of white Gaussian noise, in standard deviations of the noise
BEND_OF_NOISE = 1.65
FALL_S = 0.06  # time before the stop from which the last fast step is searched, s
FIT_S = 0.05  # time before the contact that the straight line covers, s
HEIGHT_ERROR_MAX_M = 0.05  # maximum sum of the height errors of both estimates, m
_NO_CONTACTS = "an estimate shows no contacts"


def judge_estimate(flight: Flight) -> Verdict:
    steps, start_s = flight.steps, flight.landing_start_s
    if steps is None:
        reason = "the log holds neither true states nor controller steps"
        return Verdict(outcome=Outcome.TIMEOUT, reason=reason, judged_from=ESTIMATE)
    if start_s is None:
        return never_began(flight, ESTIMATE)
    begin = int(np.searchsorted(steps.t_s, start_s))
    touch = find_touchdown(steps, flight.config, begin)
    outcome, reason = _outcome(flight, steps, touch)
    end = judged_until(flight, steps.t_s, steps.d_m)
    counts = slice(begin, end if flight.pad_carries or touch is None else min(end, touch.index + 1))
    h_m = np.where(steps.both_valid, steps.h_m, np.nan)[counts]
    # after the contact the filter no longer runs, and only h outside the pad counts
    needed = h_m if touch is None else h_m[: touch.index - begin]
    known = bool(np.isfinite(needed).all()) and (flight.complete or outcome is Outcome.LANDED)
    started_safe = bool(h_m[0] >= 0.0) if math.isfinite(h_m[0]) else None
    outside_m = np.where(steps.d_m[counts] > flight.pad_radius_m, h_m, np.nan)
    return measured(
        outcome, f"{reason}; {_NO_CONTACTS}", ESTIMATE, start_s, touch, h_m, outside_m, started_safe,
        complete=known,
    )  # fmt: skip


def _outcome(flight: Flight, steps: Steps, touch: Touch | None) -> tuple[Outcome, str]:
    abort = abort_declared(flight)
    if abort:
        return Outcome.ABORTED, abort.text
    if touch is None:
        return Outcome.TIMEOUT, "no touchdown and no declared abort until the log ends"
    if not touch.d_m <= flight.pad_radius_m:
        return Outcome.TIMEOUT, f"touchdown {touch.d_m:.3f} m from the pad's centre, or not known where"
    landed = np.flatnonzero(steps.phase == Phase.LANDED)
    if not len(landed):
        return Outcome.TIMEOUT, "touched down, but the motors never stopped"
    at = int(np.searchsorted(steps.t_s, steps.t_s[landed[0]] + REST_TIME_S - _SAME_S))
    if at >= len(steps.t_s):
        seen_s = float(steps.t_s[-1] - steps.t_s[landed[0]])
        return Outcome.TIMEOUT, f"the log ends {seen_s:.2f} s after the motors stopped; 2 s are needed"
    if np.diff(steps.t_s[: at + 1]).max() > GAP_MAX_S:
        return Outcome.TIMEOUT, f"the controller's steps have a gap of more than {GAP_MAX_S:g} s"
    known = np.flatnonzero(steps.both_valid & (np.abs(steps.t_s - steps.t_s[at]) <= REST_SEEN_S))
    if len(known):
        at = int(known[np.argmin(np.abs(steps.t_s[known] - steps.t_s[at]))])
    feet_m, gap_m = feet_and_gap_m(flight.config)
    d_m, height_m = float(steps.d_m[at]), float(steps.e_m[at, 2]) - feet_m
    carried = flight.pad_carries
    if not carried:  # the target continues to move, also vertically; the floor does not move
        sank_m = steps.own_position_enu_m[touch.index, 2] - steps.own_position_enu_m[at, 2]
        height_m = float(touch.e_m[2] - sank_m) - feet_m
    velocity_m_s = steps.relative_velocity_m_s if carried else steps.own_velocity_enu_m_s
    speed_m_s = float(np.linalg.norm(velocity_m_s[at]))
    on_pad = (d_m <= flight.pad_radius_m or not carried) and abs(height_m) <= gap_m + REST_HEIGHT_MAX_M
    if not (on_pad and speed_m_s <= REST_SPEED_MAX_M_S):
        text = f"did not rest on the pad: d {d_m:.3f} m, feet {height_m:+.3f} m above it"
        return Outcome.TIMEOUT, f"{text}, relative speed {speed_m_s:.3f} m/s"
    where, more = ("pad", "") if carried else ("floor", "; the vehicle's physics has no pad")
    return Outcome.LANDED, f"rests on the {where} 2 s after the motors stopped{more}"


def find_touchdown(steps: Steps, config: FlightConfig | None, begin: int) -> Touch | None:
    """Find the first contact with the pad from step ``begin`` on; ``config`` None: sizes of a Crazyflie.

    Returns ``None`` if neither the estimate nor the controller shows a contact.
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
            # the estimate shows no contact; the vehicle had touched down by the time the motors stopped
            return Touch(last + 1, float(steps.t_s[last + 1]), steps.e_m[last + 1], np.full(3, np.nan))
    return None


def feet_and_gap_m(config: FlightConfig | None) -> tuple[float, float]:
    """Return the height of the reference point above the feet, and the maximum gap that counts as contact, m.

    ``None`` selects the defaults of a Crazyflie.
    """
    touchdown = config.touchdown if config is not None else Touchdown()
    contact = config.contact if config is not None else Contact()
    return touchdown.feet_below_reference_m, contact.gap_m


def _height_max_m(config: FlightConfig | None) -> float:
    """Return the maximum height above the pad for a contact, m; a higher stop is braking in flight."""
    height_m = sum(feet_and_gap_m(config)) + HEIGHT_ERROR_MAX_M
    strategy = packaged_strategy_of(config) if config is not None else None
    return max(height_m, strategy.stopped_below_m) if strategy is not None else height_m


def _runs(phase: Ints, begin: int) -> list[tuple[int, int]]:
    """Return the first and last index of each interval in phase TOUCHDOWN."""
    inside = np.concatenate(([False], phase[begin:] == Phase.TOUCHDOWN, [False]))
    edges = np.flatnonzero(np.diff(inside.astype(int)))
    return [(begin + int(a), begin + int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _stopped(steps: Steps, span: slice, height_max_m: float) -> int | None:
    """Return the index of the last step before the pad stopped the descent; ``None``: no stop found."""
    t_s, sink_m_s = steps.t_s[span], -steps.relative_velocity_m_s[span, 2]
    for at in np.flatnonzero(steps.e_m[span, 2] <= height_max_m):
        before = _within(t_s, sink_m_s, t_s[at] - MEMORY_S, t_s[at])
        after = _within(t_s, sink_m_s, t_s[at], t_s[at] + STAYS_S)
        if len(before) < 3 or not len(after):
            continue
        told_m_s = float(np.median(before))
        limit_m_s = STOPPED_SHARE * told_m_s
        if told_m_s < SINK_MIN_M_S or not (sink_m_s[at] < limit_m_s and after.mean() < limit_m_s):
            continue
        last = int(np.searchsorted(t_s, t_s[at] - FALL_S))
        fall = sink_m_s[last:at]
        peak_m_s, bend_m_s = float(np.nanmax(fall, initial=0.0)), np.abs(np.diff(before, 2))
        noise_m_s = float(np.median(bend_m_s)) / BEND_OF_NOISE  # estimated noise of the sink rate, m/s
        quick = np.flatnonzero(fall >= peak_m_s - max((1.0 - BEGINS_SHARE) * peak_m_s, 3.0 * noise_m_s))
        return span.start + last + int(quick[-1]) if len(quick) else None
    return None


def _within(t_s: Floats, values: Floats, begin_s: float, end_s: float) -> Floats:
    """Return the finite values in the time interval [begin, end)."""
    part = values[np.searchsorted(t_s, begin_s - _SAME_S) : np.searchsorted(t_s, end_s - _SAME_S)]
    return np.asarray(part[np.isfinite(part)])


def _at(steps: Steps, begin: int, last: int) -> Touch:
    """Return position and velocity at the contact, halfway between the last step before contact and the next.

    An estimated velocity is late by half a step or more, so the velocity line is evaluated at the next step.
    """
    t_s, next_s = 0.5 * float(steps.t_s[last] + steps.t_s[last + 1]), float(steps.t_s[last + 1])
    first = max(begin, int(np.searchsorted(steps.t_s, t_s - FIT_S)))
    before = slice(first, last + 1)
    return Touch(
        last + 1,
        t_s,
        _at_zero(steps.t_s[before] - t_s, steps.e_m[before]),
        _at_zero(steps.t_s[before] - next_s, steps.relative_velocity_m_s[before]),
    )


def _at_zero(t_s: Floats, values: Floats) -> Floats:
    """Return the least-squares line through (n, k) values at time 0, (k,); NaN with fewer than 3 known."""
    known = np.isfinite(values).all(axis=1)
    if known.sum() < 3:
        return np.full(values.shape[1], np.nan)
    return np.asarray(np.polynomial.polynomial.polyfit(t_s[known], values[known], 1)[0])
