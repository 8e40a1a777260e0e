"""Judges a flight by the simulator's true states and contacts. Definitions: ``verdict.py``.

"Landed" is a result of these states alone: neither the phase nor the autopilot's landed state counts.
"""

from __future__ import annotations

import math

import numpy as np

from flightstack.core.types import Phase
from logs.reader.flight_data import Judged, Truth
from logs.schema.events import ContactBit
from logs.verdict.types import (
    GAP_MAX_S,
    REST_TIME_S,
    TRUTH,
    Outcome,
    Touch,
    Verdict,
    abort_declared,
    judged_until,
    measured,
    never_began,
)

REST_SPEED_MAX_M_S = 0.05  # maximum speed relative to the pad at rest, m/s; sliding and rolling are faster
LAND_AWAY_SPEED_MAX_M_S = 1.0  # maximum sink rate of a landing after an abort, m/s; higher: a crash
_SAME_S = 1e-6  # tolerance of equal times, s; much shorter than a tick


_NAMES = {
    ContactBit.GROUND: "ground",
    ContactBit.ROBOT: "robot body",
    ContactBit.PAD_EDGE: "pad edge",
    ContactBit.TUMBLED: "tumble",
    ContactBit.VEHICLE: "another vehicle",
}
_HITS = ~int(ContactBit.PAD)  # all contacts except with the top of the pad
# contacts that count as a crash also after touchdown, e.g. of one foot with the ground beside a small pad
_FALLS = int(ContactBit.GROUND | ContactBit.ROBOT | ContactBit.TUMBLED | ContactBit.VEHICLE)


def judge_truth(flight: Judged, truth: Truth) -> Verdict:
    start_s = flight.landing_start_s
    if start_s is None:
        return _never_began(flight, truth)
    # index of the first true state after the landing starts
    begin = int(np.searchsorted(truth.t_s, start_s + _SAME_S))
    if begin >= len(truth.t_s):
        reason = "the true states end before the landing began"
        return Verdict(outcome=Outcome.TIMEOUT, reason=reason, judged_from=TRUTH)
    touched = np.flatnonzero(truth.contacts[begin:])
    touch = _contact_at(truth, begin + int(touched[0])) if len(touched) else None
    outcome, reason = _outcome(flight, truth, begin, touch)
    counts = slice(begin, judged_until(flight, truth.t_s, truth.d_m))
    started_safe, gap = _started_safe(truth, start_s), _gap(truth, start_s, begin)
    missing = gap or _missing(flight, truth, start_s, counts, outcome)
    if outcome is Outcome.LANDED and gap:
        outcome, reason = Outcome.TIMEOUT, f"not shown to have landed: {missing}"
    if not missing and started_safe is None:
        missing = "true h is missing where the landing began"
    return measured(
        outcome, f"{reason}; {missing}" if missing and missing not in reason else reason, TRUTH, start_s,
        touch if touch is not None and truth.contacts[touch.index] == ContactBit.PAD else None,
        truth.h_min_m[counts], truth.h_min_outside_pad_m[counts], started_safe, complete=not missing,
    )  # fmt: skip


def _outcome(flight: Judged, truth: Truth, begin: int, touch: Touch | None) -> tuple[Outcome, str]:
    abort = abort_declared(flight)
    if abort and (touch is None or abort.t_s <= touch.t_s):
        if touch is None or _gentle_landing_away(truth, touch):
            return Outcome.ABORTED, abort.text
    elif touch is None:
        return Outcome.TIMEOUT, "no contact and no declared abort until the log ends"
    assert touch is not None
    bits = int(truth.contacts[touch.index])
    if bits & _HITS:
        return Outcome.CRASHED, f"contact before touchdown: {_names(bits)}"
    if touch.d_m > flight.pad_radius_m:
        text = f"touched the pad {touch.d_m:.3f} m from its centre, outside its {flight.pad_radius_m:.2f} m"
        return Outcome.CRASHED, text
    if not math.isfinite(touch.d_m):
        return Outcome.TIMEOUT, "touched the pad, but the log does not say where"
    outcome, reason = _after_touchdown(flight, truth, begin, touch)
    if abort and outcome is not Outcome.CRASHED and (outcome is not Outcome.LANDED or abort.t_s <= touch.t_s):
        return Outcome.ABORTED, abort.text
    return outcome, reason


def _after_touchdown(flight: Judged, truth: Truth, begin: int, touch: Touch) -> tuple[Outcome, str]:
    """Return the outcome after a touchdown: landed if at rest on the pad 2 s after the motors stop."""
    left_s = flight.began_s(Phase.LEAVE)  # start of the take-off that frees the pad for another vehicle, s
    end = len(truth.t_s) if left_s is None else int(np.searchsorted(truth.t_s, left_s + _SAME_S))
    running = np.flatnonzero(truth.motors_running[begin:end]) + begin
    off = int(running[-1]) + 1 if len(running) else begin
    rest_s = float(truth.t_s[off]) + REST_TIME_S if off < len(truth.t_s) else math.inf
    at = int(np.searchsorted(truth.t_s, rest_s - _SAME_S))
    fallen = np.flatnonzero(truth.contacts[touch.index : at + 1] & _FALLS)
    if len(fallen):
        where = touch.index + int(fallen[0])
        abort = abort_declared(flight)
        if abort and abort.t_s <= truth.t_s[where] and _gentle_landing_away(truth, _contact_at(truth, where)):
            return Outcome.ABORTED, abort.text
        return Outcome.CRASHED, f"contact after touchdown: {_names(int(truth.contacts[where]))}"
    if off >= len(truth.t_s):
        return Outcome.TIMEOUT, "touched the pad, but the motors never stopped"
    if at >= end:
        seen_s, what = float(truth.t_s[end - 1] - truth.t_s[off]), "true states end"
        what = what if end == len(truth.t_s) else "it took off again"
        return Outcome.TIMEOUT, f"{what} {seen_s:.2f} s after the motors stopped; 2 s are needed"
    speed_m_s = float(np.linalg.norm(truth.relative_velocity_m_s[at]))
    resting = bool(truth.contacts[at] & ContactBit.PAD) and truth.d_m[at] <= flight.pad_radius_m
    if not (resting and speed_m_s <= REST_SPEED_MAX_M_S):
        text = f"did not rest on the pad: d {truth.d_m[at]:.3f} m, relative speed {speed_m_s:.3f} m/s"
        return Outcome.TIMEOUT, text
    hit = _hit_after(truth, end)
    if hit:
        return Outcome.CRASHED, f"landed, and crashed after it took off again: {hit}"
    text = f"touched {touch.d_m * 100:.1f} cm from the centre, rests on the pad 2 s after the motors stopped"
    return Outcome.LANDED, text


def _hit_after(truth: Truth, begin: int) -> str:
    """Return the contacts after a second take-off, except a gentle landing on the ground; empty: none."""
    hits = np.flatnonzero(truth.contacts[begin:] & _HITS) + begin
    if not len(hits):
        return ""
    bits = int(np.bitwise_or.reduce(truth.contacts[hits]))
    if bits == ContactBit.GROUND and not _gentle_landing_away(truth, _contact_at(truth, int(hits[0]))):
        return "it fell to the ground"
    return _names(bits & ~int(ContactBit.GROUND))


def _contact_at(truth: Truth, index: int) -> Touch:
    """Return a contact, with place and velocity from the simulator's record or the previous true state."""
    before, first_s = max(index - 1, 0), float(truth.first_touch_time_s[index])
    if not math.isfinite(first_s) or first_s == truth.first_touch_time_s[before]:
        return Touch(index, float(truth.t_s[index]), truth.e_m[before], truth.relative_velocity_m_s[before])
    e_m = truth.first_touch_relative_position_enu_m[index]
    velocity_m_s = truth.first_touch_relative_velocity_enu_m_s[index]
    return Touch(index, _log_time(truth, index, first_s), e_m, velocity_m_s)


def _log_time(truth: Truth, index: int, simulated_s: float) -> float:
    """Convert a simulated time (tick number times period) between two ticks into log time, s."""
    late_s, before_s = float(truth.t_s[index]), float(truth.t_s[max(index - 1, 0)])
    ticks = truth.tick[-1] - truth.tick[0]
    if ticks <= 0:
        return late_s
    period_s = float(np.median(np.diff(truth.t_s) / np.maximum(np.diff(truth.tick), 1)))
    return min(max(late_s + simulated_s - float(truth.tick[index]) * period_s, before_s), late_s)


def _gentle_landing_away(truth: Truth, touch: Touch) -> bool:
    """Whether the vehicle touched only the ground, upright and slowly, as a declared abort may end."""
    falling_m_s = -float(truth.velocity_enu_m_s[max(touch.index - 1, 0), 2])
    return truth.contacts[touch.index] == ContactBit.GROUND and falling_m_s <= LAND_AWAY_SPEED_MAX_M_S


def _started_safe(truth: Truth, start_s: float) -> bool | None:
    nearest = int(np.argmin(np.abs(truth.t_s - start_s)))
    h_m = float(truth.h_m[nearest])
    near = abs(float(truth.t_s[nearest]) - start_s) <= GAP_MAX_S
    return h_m >= 0.0 if near and math.isfinite(h_m) else None


def _gap(truth: Truth, start_s: float, begin: int) -> str:
    """Return a text if the true states since the start of the landing have a gap; else an empty text."""
    longest_s = np.max(np.diff(truth.t_s[begin:], prepend=start_s))
    return f"true states have a gap of more than {GAP_MAX_S:g} s" if longest_s > GAP_MAX_S else ""


def _missing(flight: Judged, truth: Truth, start_s: float, counts: slice, outcome: Outcome) -> str:
    """Return a text that names missing data, which could hide a violation; empty if no data are missing."""
    lost = int(flight.metadata.get("losses", {}).get("vehicle", "0"))
    if lost:
        return f"{lost} records of the vehicle were lost"
    if np.isnan(truth.h_min_m[counts]).any() or np.isnan(truth.h_min_outside_pad_m[counts]).any():
        return "true h is missing at some ticks"
    last_s = float(flight.steps.t_s[-1]) if flight.steps is not None else start_s
    if outcome is not Outcome.LANDED and last_s - truth.t_s[-1] > GAP_MAX_S:
        return f"the true states end {last_s - truth.t_s[-1]:.2f} s before the controller's steps"
    if outcome is not Outcome.LANDED and not flight.complete:
        return "the log is cut short"
    return ""


def _never_began(flight: Judged, truth: Truth) -> Verdict:
    bits = int(np.bitwise_or.reduce(truth.contacts))
    if hits := bits & ~int(ContactBit.PAD | ContactBit.GROUND):
        reason = f"before the landing began: {_names(hits)}"
        return Verdict(outcome=Outcome.CRASHED, reason=reason, judged_from=TRUTH)
    return never_began(flight, TRUTH)


def _names(bits: int) -> str:
    return ", ".join(name for bit, name in _NAMES.items() if bits & bit)
