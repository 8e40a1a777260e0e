"""Criteria that compare the simulator with recorded flights: limits, a reason for each, and the verdict.

Every number is a statistic over flights with a 95 % interval from bootstrap over flights, because the samples
of one flight are correlated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy  # loads each part at the first use of the part, in 0.3 to 0.5 s

from sim.flights.recording import Floats
from sim.options import ValidateOptions
from sim.validation.open_loop import HORIZONS_S
from sim.validation.run import Compared
from sim.validation.sensing import SPEED_EDGES_M_S

RESAMPLES = 999
CONFIDENCE = 0.95
MET, OPEN, MISSED = "met", "open", "missed"
SHARE_MIN = 0.01  # lower limit of a fraction in a ratio; rarer saturation does not change a flight
TRACKING_WITHIN = 0.25  # relative difference of two tracking errors that counts as agreement

Statistic = Callable[..., Any]  # function that reduces arrays of equal shape along ``axis``


class Estimate(NamedTuple):
    """A statistic over flights, and the ends of its interval; the ends are NaN for one flight."""

    value: float
    low: float
    high: float


def over_flights(statistic: Statistic, *samples: Sequence[float]) -> Estimate | None:
    """Return a statistic of values per flight; flights with NaN are ignored. None: no flights."""
    table = np.array(samples, dtype=np.float64)
    table = table[:, np.isfinite(table).all(axis=0)]
    if not table.shape[1]:
        return None
    value = float(statistic(*table, axis=-1))
    if table.shape[1] == 1:
        return Estimate(value, float("nan"), float("nan"))
    found = scipy.stats.bootstrap(
        tuple(table), statistic, paired=True, vectorized=True, n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE, method="percentile", rng=0,
    )  # fmt: skip
    return Estimate(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def number(flight: Compared, path: str) -> float:
    """Return the value at a path such as ``closed_loop.recorded.duty``; NaN if a part is missing."""
    found: Any = flight
    for step in path.split("."):
        if found is None:
            return float("nan")
        found = found[int(step)] if step.isdigit() else getattr(found, step)
    return float(found)


def estimate(flights: Sequence[Compared], statistic: Statistic, *paths: str) -> Estimate | None:
    """Return a statistic of the numbers at these paths."""
    return over_flights(statistic, *([number(flight, path) for flight in flights] for path in paths))


def median_ratio(a: Floats, b: Floats, axis: int) -> Any:
    return np.median(a / b, axis=axis)


def ratio_of_means(a: Floats, b: Floats, axis: int) -> Any:
    """Return the ratio of two mean fractions; a mean below ``SHARE_MIN`` counts as ``SHARE_MIN``."""
    return np.maximum(a.mean(axis=axis), SHARE_MIN) / np.maximum(b.mean(axis=axis), SHARE_MIN)


def ratio_of_rms(a: Floats, b: Floats, axis: int) -> Any:
    return np.sqrt((a**2).mean(axis=axis) / (b**2).mean(axis=axis))


def difference_of_means(a: Floats, b: Floats, axis: int) -> Any:
    return (a - b).mean(axis=axis)


def median_difference(a: Floats, b: Floats, axis: int) -> Any:
    """Return the median over flights of the relative difference of two numbers."""
    return np.median(np.abs(a / b - 1.0), axis=axis)


def share_within(a: Floats, b: Floats, axis: int) -> Any:
    """Return the fraction of flights in which two numbers differ by at most ``TRACKING_WITHIN``."""
    return (np.abs(a / b - 1.0) <= TRACKING_WITHIN).mean(axis=axis)


@dataclass(frozen=True)
class Criterion:
    """A limit on a statistic of simulated and recorded numbers."""

    part: str  # open loop, closed loop or sensing
    text: str  # name of the compared quantity, usually the simulator's rms error divided by another rms error
    low: float  # lower limit of the statistic
    high: float  # upper limit of the statistic
    reason: str  # reason for these two limits
    statistic: Statistic
    paths: tuple[str, ...]  # paths of the criterion's numbers in the results of a flight
    # sentence for a missed limit, with a placeholder for the value; None: the sentence is made from ``text``
    cause: str | None = None
    # whether the result is random; such a criterion fails only if the whole interval is outside the limits
    by_chance: bool = False
    scale: float = 1.0  # factor from the value to the printed number
    unit: str = ""  # unit of the printed number

    @property
    def limit(self) -> str:
        low, high = (f"{self.scale * value:.4g}" for value in (self.low, self.high))
        if math.isinf(self.low):
            return f"≤ {high}{self.unit}"
        return f"≥ {low}{self.unit}" if math.isinf(self.high) else f"{low} to {high}{self.unit}"


class Verdict(NamedTuple):
    """A criterion, the estimate and ``MET``, ``OPEN`` or ``MISSED``."""

    criterion: Criterion
    found: Estimate | None
    word: str

    @property
    def met(self) -> bool:
        return self.word != MISSED

    @property
    def text(self) -> str:
        """Text of the estimate with its interval."""
        if self.found is None:
            return "no flight covers it"
        value, low, high = (f"{self.criterion.scale * each:.3g}" for each in self.found)
        interval = "" if np.isnan(self.found.low) else f" ({low} to {high})"
        return f"{value}{self.criterion.unit}{interval}"


def judge(flights: Sequence[Compared]) -> list[Verdict]:
    """Evaluate all criteria for these flights."""
    found = [(c, estimate(flights, c.statistic, *c.paths)) for c in CRITERIA]
    covered = {criterion.part for criterion, value in found if value is not None}
    return [Verdict(c, value, _word(c, value, c.part in covered)) for c, value in found]


def _word(criterion: Criterion, found: Estimate | None, part_covered: bool) -> str:
    """Return the result: ``OPEN`` if no flight covers the criterion, ``MISSED`` if none covers the part."""
    if found is None:
        return OPEN if part_covered else MISSED
    if criterion.low <= found.value <= criterion.high:
        return MET
    outside = found.low > criterion.high or found.high < criterion.low
    return OPEN if criterion.by_chance and not outside else MISSED


def causes(verdicts: Sequence[Verdict]) -> list[str]:
    """Return sentences on the differences: known causes first, then the failures of each part."""
    missed = [v for v in verdicts if not v.met]
    told = [v.criterion.cause.format(v.found.value) for v in missed if v.found and v.criterion.cause]
    for part in dict.fromkeys(v.criterion.part for v in missed):
        of_part = [v for v in missed if v.criterion.part == part]
        plain = [
            f"{v.criterion.text}: {v.text}, limit {v.criterion.limit}"
            for v in of_part
            if v.found and not v.criterion.cause
        ]
        if plain:
            told.append(f"{MEANING[part]}: " + "; ".join(plain))
        uncovered = [v.criterion.text for v in of_part if v.found is None]
        if uncovered:
            told.append(f"{part} is not judged by any flight: " + "; ".join(uncovered))
    return told


MEANING = {
    "open loop": "the recorded motor commands do not move the plant as they moved the vehicle",
    "closed loop": "the simulated firmware and vehicle do not fly the set-points as the recorded ones",
    "sensing": "the simulated vehicle state is not as wrong as the recorded one",
}
_HALF = "a model that knows the motor commands must halve the error of one that does not know them"
_TORQUE = "unknown torque is integrated twice: 0.63 was reached, 0.25 with the recorded attitude"
OPEN_LOOP_MAX = {  # by horizon, s: maximum ratio to the error of constant velocity, for position and velocity
    0.1: ((0.5, _HALF), (0.5, _HALF)),
    0.25: ((0.5, _HALF), (0.5, _HALF)),
    0.5: ((0.5, _HALF), (0.75, _TORQUE)),
}
_QUANTITIES = (("position_m", "position"), ("velocity_m_s", "velocity"))


def _closed(name: str) -> tuple[str, str]:
    return f"closed_loop.simulated.{name}", f"closed_loop.recorded.{name}"


def _sensed(name: str) -> tuple[str, str]:
    return f"sensing.simulated.{name}", f"sensing.recorded.{name}"


CRITERIA = (
    Criterion(
        "open loop", "thrust, plant / recording", 0.95, 1.05,
        "5 % of thrust are 3 % of PWM; airframes differ by 2.3 % (standard deviation)",
        np.median, ("open_loop.thrust_ratio",), "the plant's thrust is {:.2f} times the recorded one",
    ),
    *(
        Criterion(
            "open loop", f"{name} after {seconds:g} s / {reference}", -np.inf, limit, reason, median_ratio,
            (f"open_loop.horizons.{place}.{quantity}.model", f"open_loop.horizons.{place}.{quantity}.{key}"),
        )
        for place, seconds in enumerate(HORIZONS_S)
        for (quantity, name), (allowed, why) in zip(_QUANTITIES, OPEN_LOOP_MAX[seconds], strict=True)
        for key, reference, limit, reason in (
            ("constant_velocity", "constant velocity", allowed, why),
            ("ideal", "ideal body", 1.0, "lag, drag and battery must help, or they are wrong"),
        )
    ),
    Criterion(
        "closed loop", "flights with tracking within 25 %", 0.8, np.inf,
        "two flights of the same path by the same vehicle differ by as much",
        share_within, _closed("tracking_rms_m"), scale=100.0, unit=" %",
    ),
    Criterion(
        "closed loop", "PWM in hover, median difference", -np.inf, 0.03,
        "airframes differ by 2.3 % of thrust (standard deviation), 1.5 % of PWM",
        median_difference, _closed("duty"), scale=100.0, unit=" %",
    ),
    Criterion(
        "closed loop", "saturated time / recorded", 0.5, 2.0,
        "it counts rare peaks: a percent of thrust changes it by a third",
        ratio_of_means, _closed("saturated"), by_chance=True,
    ),
    *(
        Criterion(
            "sensing", f"{name} at {low:g} to {high:g} m/s / recorded", 0.8, 1.2,
            "a filter that is tuned to it then declares an envelope that is right to 20 %",
            ratio_of_rms, _sensed(f"{name}.by_speed.{band}"), by_chance=True,
        )
        for name in ("position", "velocity")
        for band, (low, high) in enumerate(pairwise(SPEED_EDGES_M_S))
    ),
    *(
        Criterion(
            "sensing", f"delay of {name} - recorded", -0.005, 0.005,
            "half a sample of the recordings; 5 mm at 1 m/s",
            difference_of_means, _sensed(f"{name}.delay_s"), by_chance=True, scale=1000.0, unit=" ms",
        )
        for name in ("position", "velocity")
    ),
)  # fmt: skip


def summary(
    options: ValidateOptions, flights: Sequence[Compared], verdicts: Sequence[Verdict]
) -> dict[str, Any]:
    """Return the object that ``--json`` prints; SI units, intervals of 95 %; NaN becomes null there."""
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
        "criteria": [_verdict(verdict) for verdict in verdicts],
        "passed": met,
        "causes": [] if met else told,
        "by_flight": used,
    }


def reasons(flight: Compared) -> list[str]:
    """Return the reasons why a flight or parts of a flight are left out."""
    return [f"{r.text} ({r.seconds:.1f} s)" if flight.used else r.text for r in flight.left_out]


def _left_out(flight: Compared) -> dict[str, Any]:
    return {"name": flight.name, "reasons": reasons(flight)}


def _verdict(verdict: Verdict) -> dict[str, Any]:
    c = verdict.criterion
    return {
        "part": c.part, "text": c.text, "limit": c.limit, "reason": c.reason, "found": verdict.text,
        "value": verdict.found and verdict.found.value,
        "interval": [verdict.found.low, verdict.found.high] if verdict.found else [None, None],
        "met": verdict.met, "word": verdict.word,
    }  # fmt: skip
