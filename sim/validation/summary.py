"""Builds one object with the results of a comparison, for ``--json`` and the page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from sim.flights.recording import Floats
from sim.options import ValidateOptions
from sim.validation.closed_loop import Flown
from sim.validation.criteria import Estimate, Statistic, Verdict, causes, estimate
from sim.validation.open_loop import HORIZONS_S
from sim.validation.run import Compared
from sim.validation.sensing import SPEED_EDGES_M_S

QUANTITIES = ("position_m", "velocity_m_s", "attitude_rad")
PREDICTORS = ("model", "constant_velocity", "ideal")
SIDES = ("recorded", "simulated")


def summary(
    options: ValidateOptions, flights: Sequence[Compared], verdicts: Sequence[Verdict]
) -> dict[str, Any]:
    """Return the object that ``--json`` prints; medians over flights with 95 % intervals, SI units."""
    used = [flight for flight in flights if flight.used]
    met = bool(used) and all(verdict.met for verdict in verdicts)
    told = causes(verdicts) if used else ["nothing is left to compare with"]
    return {
        "folder": str(options.folder),
        "vehicle": options.vehicle,
        "seed": options.seed,
        "flights": len(flights),
        "used": len(used),
        "used_s": sum(flight.used_s for flight in used),
        "left_out": [_left_out(flight) for flight in flights if not flight.used],
        "cut": [_left_out(flight) for flight in used if flight.left_out],
        "open_loop": {f"{seconds:g}": _horizon(used, place) for place, seconds in enumerate(HORIZONS_S)},
        "closed_loop": _closed_loop(used),
        "sensing": {name: _sensing(used, name) for name in ("position", "velocity")},
        "criteria": [_verdict(verdict) for verdict in verdicts],
        "passed": met,
        "causes": [] if met else told,
        "by_flight": [plain(flight) for flight in used],
    }


def plain(value: Any) -> Any:
    """Convert dataclasses and arrays to JSON types; NaN, which JSON lacks, becomes None."""
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
    """Return the reasons why a flight, or parts of it, are left out."""
    return [f"{r.text} ({r.seconds:.1f} s)" if flight.used else r.text for r in flight.left_out]


def _left_out(flight: Compared) -> dict[str, Any]:
    return {"name": flight.name, "reasons": reasons(flight)}


def _of(found: Estimate | None) -> dict[str, Any]:
    if found is None:
        return {"value": None, "interval": [None, None]}
    return {"value": plain(found.value), "interval": plain([found.low, found.high])}


def _numbers(used: Sequence[Compared], path: str, statistic: Statistic = np.median) -> dict[str, Any]:
    return _of(estimate(used, statistic, path))


def _horizon(used: Sequence[Compared], place: int) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for quantity in QUANTITIES:
        found = {p: _numbers(used, f"open_loop.horizons.{place}.{quantity}.{p}") for p in PREDICTORS}
        told[quantity] = {p: each["value"] for p, each in found.items()}
        told[quantity]["interval"] = {p: each["interval"] for p, each in found.items()}
    return told


def _closed_loop(used: Sequence[Compared]) -> dict[str, Any]:
    flown = Counter(flight.closed_loop.controller for flight in used if flight.closed_loop is not None)
    return {"flights": dict(flown)} | {
        name: {side: _numbers(used, f"closed_loop.{side}.{name}") for side in SIDES}
        for name in ("tracking_rms_m", *Flown._fields)
    }


def _sensing(used: Sequence[Compared], name: str) -> dict[str, Any]:
    """Summarise errors of position or velocity: median delay; by speed, rms over flights."""
    told: dict[str, Any] = {"speed_m_s": list(SPEED_EDGES_M_S)}
    for side in SIDES:
        where = f"sensing.{side}.{name}"
        bands = range(len(SPEED_EDGES_M_S) - 1)
        told[side] = {
            "delay_s": _numbers(used, f"{where}.delay_s"),
            "by_speed": [_numbers(used, f"{where}.by_speed.{band}", _rms) for band in bands],
        }
    return told


def _rms(values: Floats, axis: int) -> Any:
    return np.sqrt((values**2).mean(axis=axis))


def _verdict(verdict: Verdict) -> dict[str, Any]:
    c = verdict.criterion
    return {
        "part": c.part, "text": c.text, "limit": c.limit, "reason": c.reason, "found": verdict.text,
        **_of(verdict.found), "met": verdict.met, "word": verdict.word,
    }  # fmt: skip
