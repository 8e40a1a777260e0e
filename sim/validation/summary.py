"""The result of a comparison as one object, for ``--json`` and the page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from sim.validation.closed_loop import Flown
from sim.validation.criteria import HORIZONS_S, Estimate, Verdict, causes, over_flights, tracking_m
from sim.validation.run import Compared, Plan
from sim.validation.sensing import BANDS_HZ, SPEED_EDGES_M_S, Error

QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad")
PREDICTORS = ("model", "constant_velocity", "ideal")
SIDES = ("recorded", "simulated")


def summary(plan: Plan, flights: Sequence[Compared], verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return what ``--json`` prints; medians over flights with intervals of 95 %, SI units."""
    used = [flight for flight in flights if flight.used]
    met = bool(used) and all(verdict.met for verdict in verdicts)
    told = causes(verdicts) if used else ["nothing is left to compare with"]
    if plan.shuffle_pwm and not met:
        told.insert(0, "the motor commands were shuffled in time (--shuffle-pwm)")
    return {
        "folder": str(plan.folder),
        "vehicle": plan.vehicle,
        "shuffle_pwm": plan.shuffle_pwm,
        "seed": plan.seed,
        "flights": len(flights),
        "used": len(used),
        "used_s": sum(flight.used_s for flight in used),
        "left_out": [_left_out(flight) for flight in flights if not flight.used],
        "cut": [_left_out(flight) for flight in used if flight.left_out],
        "open_loop": {f"{seconds:g}": _horizon(used, seconds) for seconds in HORIZONS_S},
        "closed_loop": _closed_loop(used),
        "sensing": {name: _sensing(used, name) for name in ("position", "velocity")},
        "criteria": [_verdict(verdict) for verdict in verdicts],
        "passed": met,
        "causes": [] if met else told,
        "by_flight": [plain(flight) for flight in used],
    }


def plain(value: Any) -> Any:
    """Turn dataclasses and arrays into what JSON has; NaN, which it has not, into None."""
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if hasattr(value, "_asdict"):
        return {name: plain(each) for name, each in value._asdict().items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


def reasons(flight: Compared) -> list[str]:
    """Why a flight, or parts of it, are left out."""
    return [f"{r.text} ({r.seconds:.1f} s)" if flight.used else r.text for r in flight.left_out]


def _left_out(flight: Compared) -> dict[str, Any]:
    return {"name": flight.name, "reasons": reasons(flight)}


def _of(estimate: Estimate | None) -> dict[str, Any]:
    if estimate is None:
        return {"value": None, "interval": [None, None]}
    return {"value": plain(estimate.value), "interval": plain([estimate.low, estimate.high])}


def _median(values: Sequence[float]) -> Estimate | None:
    return over_flights(np.median, values)


def _horizon(used: Sequence[Compared], seconds: float) -> dict[str, Any]:
    horizons = [
        horizon
        for flight in used
        if flight.open_loop is not None
        for horizon in flight.open_loop.horizons
        if horizon.seconds == seconds
    ]
    told: dict[str, Any] = {}
    for quantity in QUANTITIES:
        found = {p: _of(_median([getattr(getattr(h, quantity), p) for h in horizons])) for p in PREDICTORS}
        told[quantity] = {
            **{predictor: each["value"] for predictor, each in found.items()},
            "interval": {predictor: each["interval"] for predictor, each in found.items()},
        }
    return told


def _closed_loop(used: Sequence[Compared]) -> dict[str, Any]:
    both = [flight.closed_loop for flight in used if flight.closed_loop is not None]
    values: dict[str, Callable[[Flown], float]] = {"tracking_rms_m": tracking_m}
    values |= {name: attrgetter(name) for name in Flown._fields}
    return {
        "flights": dict(Counter(each.controller for each in both)),
        **{
            name: {side: _of(_median([value(getattr(each, side)) for each in both])) for side in SIDES}
            for name, value in values.items()
        },
    }


def _sensing(used: Sequence[Compared], name: str) -> dict[str, Any]:
    """Return the errors of one quantity: medians over flights, rms by speed as root mean square."""
    told: dict[str, Any] = {"speed_m_s": list(SPEED_EDGES_M_S), "bands_hz": [list(band) for band in BANDS_HZ]}
    for side in SIDES:
        errors = [getattr(getattr(f.sensing, side), name) for f in used if f.sensing is not None]
        told[side] = {key: _of(_median([value(e) for e in errors])) for key, value in _SENSED.items()} | {
            "by_speed": [_of(over_flights(_rms, [e.by_speed[band] for e in errors]))
                         for band in range(len(SPEED_EDGES_M_S) - 1)],
            "spectrum": [_of(_median([e.spectrum[band] for e in errors])) for band in range(len(BANDS_HZ))],
        }  # fmt: skip
    return told


def _rms(values: Any, axis: int) -> Any:
    return np.sqrt((values**2).mean(axis=axis))


def _norm(error: Error) -> float:
    return math.sqrt(sum(each**2 for each in error.rms))


_NAMES = ("delay_s", "along", "across", "median", "p95", "correlation_s")
_SENSED: dict[str, Callable[[Error], float]] = {"rms": _norm, **{name: attrgetter(name) for name in _NAMES}}


def _verdict(verdict: Verdict) -> dict[str, Any]:
    c = verdict.criterion
    return {
        "part": c.part,
        "text": c.text,
        "limit": c.limit,
        "reason": c.reason,
        "found": verdict.told,
        **_of(verdict.found),
        "met": verdict.met,
        "word": verdict.word,
    }
