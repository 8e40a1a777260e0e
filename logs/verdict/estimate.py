"""Judging by the vehicle's own estimate, for logs without true states. Definitions: ``verdict.py``.

An estimate knows no contacts: where it shows that the pad stopped the descent stands for the first contact,
phase LANDED for the motors that stopped, and a crash that the stack did not notice looks like a timeout. The
reason says so. Its numbers are as good as the estimates of vehicle and target: a constant error of either
does not show.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.core.types import Phase
from logs.reader.flight_data import Flight, Steps
from logs.verdict.estimate_touchdown import EstimatedTouchdown, feet_and_gap_m, find_touchdown
from logs.verdict.types import (
    ESTIMATE,
    GAP_MAX_S,
    REST_TIME_S,
    Outcome,
    Verdict,
    abort_declared,
    finite,
    judged_until,
    lowest,
    violated,
)

REST_SPEED_MAX_M_S = 0.10  # relative to the pad; a resting vehicle's estimate still carries noise
REST_HEIGHT_MAX_M = 0.05  # of the feet over or under the pad, beyond the configured gap: two estimates drift
_SAME_S = 1e-6  # below the resolution of a tick
_NO_CONTACTS = "an estimate shows no contacts"


def judge_estimate(flight: Flight) -> Verdict:
    """Judge a flight by what the controller believed."""
    steps, start_s = flight.steps, flight.landing_start_s
    if steps is None:
        return _nothing(Outcome.TIMEOUT, "the log holds neither true states nor controller steps")
    if start_s is None:
        abort = abort_declared(flight)
        if abort:
            return _nothing(Outcome.ABORTED, f"before the landing began: {abort.text}")
        return _nothing(Outcome.TIMEOUT, "the landing never began: no controller step in phase APPROACH")
    begin = int(np.searchsorted(steps.t_s, start_s))
    touch = find_touchdown(steps, flight.config, begin)
    outcome, reason = _outcome(flight, steps, touch)
    counts = slice(begin, judged_until(flight, steps.t_s, steps.d_m))
    d_m, h_m = steps.d_m[counts], np.where(steps.both_valid, steps.h_m, np.nan)[counts]
    # After touchdown the filter no longer runs, and h outside the pad is all that counts.
    needed = h_m if touch is None else h_m[: touch.index - begin]
    known = bool(np.isfinite(needed).all()) and (flight.complete or outcome is Outcome.LANDED)
    started_safe = bool(h_m[0] >= 0.0) if math.isfinite(h_m[0]) else None
    outside_m = lowest(np.where(d_m > flight.pad_radius_m, h_m, np.nan))
    vx, vy, vz = (math.nan,) * 3 if touch is None else touch.velocity_m_s
    return Verdict(
        outcome=outcome,
        violation=violated(outside_m, started_safe, complete=known and started_safe is not None),
        h_min_m=lowest(h_m),
        h_min_outside_pad_m=outside_m,
        touchdown_error_m=None if touch is None else finite(touch.d_m),
        touchdown_speed_vertical_m_s=finite(-vz),
        touchdown_speed_horizontal_m_s=finite(math.hypot(vx, vy)),
        time_to_land_s=touch.t_s - start_s if touch is not None and outcome is Outcome.LANDED else None,
        reason=f"{reason}; {_NO_CONTACTS}",
        started_safe=started_safe,
        judged_from=ESTIMATE,
    )


def _outcome(flight: Flight, steps: Steps, touch: EstimatedTouchdown | None) -> tuple[Outcome, str]:
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
    feet_m, gap_m = feet_and_gap_m(flight.config)
    d_m, height_m = float(steps.d_m[at]), float(steps.e_m[at, 2]) - feet_m
    speed_m_s = float(np.linalg.norm(steps.relative_velocity_m_s[at]))
    on_pad = d_m <= flight.pad_radius_m and abs(height_m) <= gap_m + REST_HEIGHT_MAX_M
    if not (on_pad and speed_m_s <= REST_SPEED_MAX_M_S):
        text = f"did not rest on the pad: d {d_m:.3f} m, feet {height_m:+.3f} m above it"
        return Outcome.TIMEOUT, f"{text}, relative speed {speed_m_s:.3f} m/s"
    return Outcome.LANDED, "rests on the pad 2 s after the motors stopped"


def _nothing(outcome: Outcome, reason: str) -> Verdict:
    return Verdict(outcome, None, None, None, None, None, None, None, reason, None, ESTIMATE)
