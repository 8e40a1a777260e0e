"""Outcomes, limits, and the verdict of a flight."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from flightstack.core.types import Phase
from logs.reader.flight_data import Floats, Judged
from logs.schema.events import CAUSE

VIOLATION_LIMIT_M = -0.005  # violation limit, m: a lower h outside the pad violates the barrier
# ellipsoid radii of a vehicle, m (examples of Crazyswarm; firmware: 0.3 and 0.9); those of a pair are added
RADIUS_BESIDE_M = 0.125
RADIUS_ABOVE_M = 0.375
REST_TIME_S = 2.0  # time at rest after the motors stop, s
GAP_MAX_S = 0.2  # longest time without data, s; events in a longer gap are unknown
TRUTH = "truth"
ESTIMATE = "estimate"
SOURCES = {TRUTH: "true states", ESTIMATE: "the vehicle's own estimate"}  # texts of ``judged_from``
BELOW_ON_PAD = (
    "h is the height above the boundary that the filter keeps. Over the pad it may be below 0 and does not "
    "count: beside the landing spot the boundary is higher than the reference point of a vehicle that stands "
    "on the pad"
)
FALL_M_S = 0.5  # vertical speed at touchdown above which a landing is described as a fall
FALLS = (
    'A touchdown faster than 0.5 m/s is usually a fall: touchdown.rule = "paper" stops the motors a few '
    'centimetres above the pad, as the paper does; with "contact" they run until contact'
)
_SAID_WITHIN_S = 0.1  # maximum time between an event and its tick, s, with a margin for clock differences


class Outcome(StrEnum):
    """Outcome of a flight, judged from its log.

    LANDED requires more than phase LANDED of the controller (motors off) or the autopilot's landed state.
    """

    LANDED = "landed"
    ABORTED = "aborted"
    CRASHED = "crashed"
    TIMEOUT = "timeout"
    UNKNOWN = "unknown"  # the log lacks records; does not occur in a campaign


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a flight; ``None`` for a value that does not apply or is unknown."""

    outcome: Outcome  # outcome of the flight
    # whether h < -5 mm outside the pad, in a run that began with h >= 0; ``None`` if data are missing
    violation: bool | None
    h_min_m: float | None  # lowest h since the landing began
    h_min_outside_pad_m: float | None  # lowest h where d > pad radius
    touchdown_error_m: float | None  # distance d at the first contact; None: the contact is not with the pad
    # vertical speed relative to the pad's surface at the first contact, positive downwards
    touchdown_speed_vertical_m_s: float | None
    touchdown_speed_horizontal_m_s: float | None  # horizontal speed relative to the pad's surface
    time_to_land_s: float | None  # time from the start of the landing to first contact, if landed
    reason: str  # reason of the outcome, as text
    started_safe: bool | None  # whether h >= 0 at the start of the landing; ``None`` if unknown
    judged_from: str  # source of the verdict: ``TRUTH`` or ``ESTIMATE``

    @staticmethod
    def unknown(outcome: Outcome, reason: str, judged_from: str) -> Verdict:
        """Return a verdict with an outcome but without numbers."""
        return Verdict(outcome, None, None, None, None, None, None, None, reason, None, judged_from)

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values; a number that is not finite becomes ``None``."""
        values = asdict(self)
        values["outcome"] = self.outcome.value
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def finite(value: float) -> float | None:
    """Return the number, or ``None`` if it is not finite."""
    return float(value) if math.isfinite(value) else None


def lowest(values: Floats) -> float | None:
    """Return the smallest number; ``None`` if it is not finite (+inf: no step was outside the pad)."""
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else None


def violated(h_min_outside_pad_m: float | None, started_safe: bool | None, *, complete: bool) -> bool | None:
    """Whether the barrier was violated; ``None`` if missing data could hide a violation."""
    if started_safe is False:
        return False
    if h_min_outside_pad_m is not None and h_min_outside_pad_m < VIOLATION_LIMIT_M:
        return True
    return False if complete else None


@dataclass(frozen=True, slots=True)
class Abort:
    t_s: float
    text: str


def abort_declared(flight: Judged) -> Abort | None:
    """Return time and reason of the first step in phase ABORT; ``None`` if there is no such step."""
    if flight.steps is None:
        return None
    steps = np.flatnonzero(flight.steps.phase == Phase.ABORT)
    if not len(steps):
        return None
    t_s = float(flight.steps.t_s[steps[0]])
    near = [e.text for e in flight.events if abs(e.t_s - t_s) <= _SAID_WITHIN_S and "abort" in e.text.lower()]
    causes = [f"; {text.removeprefix(CAUSE)}" for text in near if text.startswith(CAUSE)]
    said = [text for text in near if not text.startswith(CAUSE)] or ["no reason in the log"]
    return Abort(t_s, f"declared abort: {said[0]}{''.join(causes[:1])}")


def never_began(flight: Judged, judged_from: str) -> Verdict:
    """Return the verdict on a flight without a controller step in phase APPROACH."""
    abort = abort_declared(flight)
    if abort:
        return Verdict.unknown(Outcome.ABORTED, f"before the landing began: {abort.text}", judged_from)
    reason = "the landing never began: no controller step in phase APPROACH"
    return Verdict.unknown(Outcome.TIMEOUT, reason, judged_from)


def left_s(flight: Judged) -> float:
    """Return the time of the take-off that frees the pad for another vehicle; inf: there is none."""
    if flight.steps is None:
        return math.inf
    steps = np.flatnonzero(flight.steps.phase == Phase.LEAVE)
    return float(flight.steps.t_s[steps[0]]) if len(steps) else math.inf


def judged_until(flight: Judged, t_s: Floats, d_m: Floats) -> int:
    """Return the index of the first state whose h no longer counts, after an abort or a take-off that clears.

    A vehicle that lands beside the robot ends below its pad, where h < 0 by geometry. The first state beyond
    the clearance distance still counts, with the physics steps before it. Without the configuration the
    clearance distance is unknown, and all states count.
    """
    abort = abort_declared(flight)
    since_s = min(abort.t_s if abort is not None else math.inf, left_s(flight))
    if flight.config is None:
        return len(t_s)
    found = np.flatnonzero((t_s > since_s) & (d_m > flight.config.checks.clearance_m))
    return int(found[0]) + 1 if len(found) else len(t_s)
