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
# ellipsoid radii of a vehicle, m (examples of Crazyswarm; firmware: 0.3 and 0.9); a pair has their sum
RADIUS_BESIDE_M = 0.125
RADIUS_ABOVE_M = 0.375
REST_TIME_S = 2.0  # time at rest after the motors stop, s
GAP_MAX_S = 0.2  # maximum allowed time without data, s
TRUTH = "truth"
ESTIMATE = "estimate"
PROCESS = "process"
# texts of ``judged_from``
SOURCES = {
    TRUTH: "true states",
    ESTIMATE: "the vehicle's own estimate",
    PROCESS: "the onboard process's report",
}
BELOW_ON_PAD = (
    "h is the height above the boundary that the filter keeps. Over the pad it may be below 0 and does not "
    "count: beside the landing spot the boundary is higher than the reference point of a vehicle that stands "
    "on the pad"
)
FALL_M_S = 0.5  # vertical touchdown speed above which the report describes a fall, m/s
FALLS = (
    'A touchdown faster than 0.5 m/s is usually a fall: touchdown.rule = "paper" stops the motors a few '
    'centimetres above the pad, as the paper does; with "contact" they run until contact'
)
_SAID_WITHIN_S = 0.1  # maximum time between the start of phase ABORT and its event, s; clocks may differ


class Outcome(StrEnum):
    """Outcome of a flight, judged from its log.

    LANDED requires more than phase LANDED of the controller (motors off) or the autopilot's landed state.
    """

    LANDED = "landed"
    ABORTED = "aborted"
    CRASHED = "crashed"
    TIMEOUT = "timeout"
    UNKNOWN = "unknown"  # the log lacks records; does not occur in a campaign


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Verdict on a flight; ``None`` for a value that does not apply or is unknown."""

    outcome: Outcome  # outcome of the flight
    # whether h < -5 mm outside the pad, in a run that began with h >= 0; None: data are missing
    violation: bool | None = None
    h_min_m: float | None = None  # lowest h since the landing began, m
    h_min_outside_pad_m: float | None = None  # lowest h where d > pad radius, m
    # distance d at the first contact, m; None: no contact, or not with the pad
    touchdown_error_m: float | None = None
    # vertical speed relative to the pad's surface at the first contact, m/s, positive downwards
    touchdown_speed_vertical_m_s: float | None = None
    touchdown_speed_horizontal_m_s: float | None = None  # horizontal speed relative to the pad, m/s
    time_to_land_s: float | None = None  # time from the landing's start to the first contact, s
    reason: str  # reason of the outcome, as text
    started_safe: bool | None = None  # whether h >= 0 at the start of the landing; None: unknown
    judged_from: str  # source of the verdict: a key of ``SOURCES``

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return {**asdict(self), "outcome": self.outcome.value}


@dataclass(frozen=True, slots=True)
class Touch:
    """A contact, with position and velocity just before the contact; NaN: unknown."""

    index: int  # index of the first state at or after the contact
    t_s: float  # time of the contact, s
    e_m: Floats  # position relative to the pad's centre, ENU, m, (3,)
    velocity_m_s: Floats  # velocity relative to the pad's surface, ENU, m/s, (3,)

    @property
    def d_m(self) -> float:
        """Horizontal distance to the pad's centre, m."""
        return float(np.hypot(self.e_m[0], self.e_m[1]))


def measured(
    outcome: Outcome, reason: str, judged_from: str, start_s: float, touch: Touch | None, h_m: Floats,
    h_outside_pad_m: Floats, started_safe: bool | None, *, complete: bool,
) -> Verdict:  # fmt: skip
    """Return a verdict with the numbers of a landing.

    ``touch``: contact with the pad; ``h_m``, ``h_outside_pad_m``: values at the states that count;
    ``complete``: no data are missing that could hide a violation.
    """
    outside_m = _lowest(h_outside_pad_m)
    violation: bool | None = outside_m is not None and outside_m < VIOLATION_LIMIT_M
    if started_safe is False:
        violation = False
    elif not violation and not (complete and started_safe):
        violation = None
    vx, vy, vz = (math.nan,) * 3 if touch is None else touch.velocity_m_s
    return Verdict(
        outcome=outcome,
        violation=violation,
        h_min_m=_lowest(h_m),
        h_min_outside_pad_m=outside_m,
        touchdown_error_m=None if touch is None else _finite(touch.d_m),
        touchdown_speed_vertical_m_s=_finite(-vz),
        touchdown_speed_horizontal_m_s=_finite(math.hypot(vx, vy)),
        time_to_land_s=touch.t_s - start_s if touch is not None and outcome is Outcome.LANDED else None,
        reason=reason,
        started_safe=started_safe,
        judged_from=judged_from,
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _lowest(values: Floats) -> float | None:
    """Return the smallest number; ``None`` if it is not finite (+inf: no step was outside the pad)."""
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else None


@dataclass(frozen=True, slots=True)
class Abort:
    t_s: float
    text: str


def abort_declared(flight: Judged) -> Abort | None:
    """Return time and reason of the first step in phase ABORT; ``None`` if there is no such step."""
    t_s = flight.began_s(Phase.ABORT)
    if t_s is None:
        return None
    near = [e.text for e in flight.events if abs(e.t_s - t_s) <= _SAID_WITHIN_S and "abort" in e.text.lower()]
    causes = [f"; {text.removeprefix(CAUSE)}" for text in near if text.startswith(CAUSE)]
    said = [text for text in near if not text.startswith(CAUSE)] or ["no reason in the log"]
    return Abort(t_s, f"declared abort: {said[0]}{''.join(causes[:1])}")


def never_began(flight: Judged, judged_from: str) -> Verdict:
    """Return the verdict on a flight without a controller step in phase APPROACH."""
    abort = abort_declared(flight)
    outcome, reason = Outcome.TIMEOUT, "the landing never began: no controller step in phase APPROACH"
    if abort:
        outcome, reason = Outcome.ABORTED, f"before the landing began: {abort.text}"
    return Verdict(outcome=outcome, reason=reason, judged_from=judged_from)


def judged_until(flight: Judged, t_s: Floats, d_m: Floats) -> int:
    """Return the index of the first state whose h does not count, after an abort or after leaving the pad.

    A vehicle that lands beside the robot ends below the pad, where h < 0 by geometry. The first state beyond
    the clearance distance still counts, with the physics steps before it. Without the configuration the
    clearance distance is unknown, and all states count.
    """
    began_s = [t for phase in (Phase.ABORT, Phase.LEAVE) if (t := flight.began_s(phase)) is not None]
    if flight.config is None or not began_s:
        return len(t_s)
    since_s = min(began_s)
    found = np.flatnonzero((t_s > since_s) & (d_m > flight.config.checks.clearance_m))
    return int(found[0]) + 1 if len(found) else len(t_s)
