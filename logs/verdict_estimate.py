"""Judging by the vehicle's own estimate, for logs without true states. Definitions: ``verdict.py``.

An estimate knows no contacts: the phase machine's TOUCHDOWN stands for the first contact and LANDED for the
motors that stopped, and a crash that the stack did not notice looks like a timeout. The reason says so.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.types import Phase
from logs.flight_data import Bools, Flight, Steps
from logs.verdict_types import (
    ESTIMATE,
    GAP_MAX_S,
    REST_TIME_S,
    Outcome,
    Verdict,
    abort_declared,
    finite,
    lowest,
    violated,
)

REST_SPEED_MAX_M_S = 0.10  # relative to the pad; a resting vehicle's estimate still carries noise
REST_HEIGHT_MAX_M = 0.05  # of the reference point above the pad: feet (14 mm) and noise
_SAME_S = 1e-6  # below the resolution of a tick
_NO_CONTACTS = "judged by the estimate, which shows no contacts"


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
    touch = _first(np.isin(steps.phase, (Phase.TOUCHDOWN, Phase.LANDED)), begin)
    outcome, reason = _outcome(flight, steps, touch)
    d_m, h_m = steps.d_m[begin:], steps.h_m[begin:]
    # After touchdown the filter no longer runs, and h outside the pad is all that counts.
    until = len(steps.t_s) if touch is None else touch
    known = bool((steps.both_valid & np.isfinite(steps.h_m))[begin:until].all())
    known = known and (flight.complete or outcome is Outcome.LANDED)
    usable = steps.both_valid[begin:]
    h_m = np.where(usable, h_m, np.nan)
    started_safe = bool(h_m[0] >= 0.0) if math.isfinite(h_m[0]) else None
    outside_m = lowest(np.where(d_m > flight.pad_radius_m, h_m, np.nan))
    v_m_s = np.full(3, np.nan) if touch is None else _relative_velocity(steps, touch)
    return Verdict(
        outcome=outcome,
        violation=violated(outside_m, started_safe, complete=known and started_safe is not None),
        h_min_m=lowest(h_m),
        h_min_outside_pad_m=outside_m,
        touchdown_error_m=None if touch is None else finite(steps.d_m[touch]),
        touchdown_speed_vertical_m_s=finite(-v_m_s[2]),
        touchdown_speed_horizontal_m_s=finite(float(np.hypot(v_m_s[0], v_m_s[1]))),
        time_to_land_s=(
            float(steps.t_s[touch] - start_s) if touch is not None and outcome is Outcome.LANDED else None
        ),
        reason=f"{reason}; {_NO_CONTACTS}",
        started_safe=started_safe,
        judged_from=ESTIMATE,
    )


def _outcome(flight: Flight, steps: Steps, touch: int | None) -> tuple[Outcome, str]:
    abort = abort_declared(flight)
    if abort:
        return Outcome.ABORTED, abort.text
    if touch is None:
        return Outcome.TIMEOUT, "no touchdown and no declared abort until the log ends"
    if not steps.d_m[touch] <= flight.pad_radius_m:
        return (
            Outcome.TIMEOUT,
            f"touchdown {steps.d_m[touch]:.3f} m from the pad's centre, or not known where",
        )
    landed = _first(steps.phase == Phase.LANDED, touch)
    if landed is None:
        return Outcome.TIMEOUT, "touched down, but the motors never stopped"
    at = int(np.searchsorted(steps.t_s, steps.t_s[landed] + REST_TIME_S - _SAME_S))
    if at >= len(steps.t_s):
        seen_s = float(steps.t_s[-1] - steps.t_s[landed])
        return Outcome.TIMEOUT, f"the log ends {seen_s:.2f} s after the motors stopped; 2 s are needed"
    if np.diff(steps.t_s[: at + 1]).max() > GAP_MAX_S:
        return Outcome.TIMEOUT, f"the controller's steps have a gap of more than {GAP_MAX_S:g} s"
    speed_m_s = float(np.linalg.norm(_relative_velocity(steps, at)))
    rests = steps.d_m[at] <= flight.pad_radius_m and abs(steps.e_m[at, 2]) <= REST_HEIGHT_MAX_M
    if not (rests and speed_m_s <= REST_SPEED_MAX_M_S):
        text = f"did not rest on the pad: d {steps.d_m[at]:.3f} m, relative speed {speed_m_s:.3f} m/s"
        return Outcome.TIMEOUT, text
    return Outcome.LANDED, "rests on the pad 2 s after the motors stopped"


def _first(mask: Bools, begin: int) -> int | None:
    found = np.flatnonzero(mask[begin:])
    return begin + int(found[0]) if len(found) else None


def _relative_velocity(steps: Steps, at: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(steps.own_velocity_enu_m_s[at] - steps.target_velocity_enu_m_s[at])


def _nothing(outcome: Outcome, reason: str) -> Verdict:
    return Verdict(outcome, None, None, None, None, None, None, None, reason, None, ESTIMATE)
