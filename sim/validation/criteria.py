"""What the simulator must reach beside recorded flights, each limit with its reason, and what it has reached.

Every number is a statistic over flights with an interval of 95 % by bootstrap over flights: two flights of a
day are more alike than two samples of a noise, so that samples of one flight do not count as many.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.stats import bootstrap

from sim.flights.recording import Floats
from sim.validation.closed_loop import Flown
from sim.validation.run import Compared
from sim.validation.sensing import SPEED_EDGES_M_S, Error

HORIZONS_S = (0.1, 0.25, 0.5)
RESAMPLES = 999
CONFIDENCE = 0.95
MET, OPEN, MISSED = "met", "open", "missed"
SHARE_MIN = 0.01  # rarer saturation does not change a flight


class Estimate(NamedTuple):
    """A statistic over flights with its interval; the ends are NaN where one flight alone gives it."""

    value: float
    low: float
    high: float


def over_flights(statistic: Callable[..., Floats], *samples: Sequence[float]) -> Estimate | None:
    """Find a statistic of one number or several a flight, and its interval.

    ``statistic``: of arrays of the same shape along ``axis``; ``samples``: for each number, its value in each
    flight; flights where one is NaN are left out.
    Returns None without a flight.
    """
    table = np.array(samples, dtype=np.float64)
    table = table[:, np.isfinite(table).all(axis=0)]
    if not table.shape[1]:
        return None
    value = float(statistic(*table, axis=-1))
    if table.shape[1] == 1:
        return Estimate(value, float("nan"), float("nan"))
    found = bootstrap(
        tuple(table), statistic, paired=True, vectorized=True, n_resamples=RESAMPLES,
        confidence_level=CONFIDENCE, method="percentile", rng=0,
    )  # fmt: skip
    return Estimate(value, float(found.confidence_interval.low), float(found.confidence_interval.high))


def median_ratio(a: Floats, b: Floats, axis: int) -> Floats:
    """Median over flights of one number over another."""
    return np.asarray(np.median(a / b, axis=axis))


def ratio_of_means(a: Floats, b: Floats, axis: int) -> Floats:
    """Mean of one share over the mean of another; what is less than ``SHARE_MIN`` counts as that."""
    return np.asarray(np.maximum(a.mean(axis=axis), SHARE_MIN) / np.maximum(b.mean(axis=axis), SHARE_MIN))


def ratio_of_rms(a: Floats, b: Floats, axis: int) -> Floats:
    """Root mean square over flights of one number over that of another."""
    return np.asarray(np.sqrt((a**2).mean(axis=axis) / (b**2).mean(axis=axis)))


def difference_of_means(a: Floats, b: Floats, axis: int) -> Floats:
    """Mean over flights of a difference."""
    return np.asarray((a - b).mean(axis=axis))


@dataclass(frozen=True)
class Criterion:
    """One limit."""

    part: str  # open loop, closed loop or sensing
    text: str  # what is compared; by default rms errors, those of the simulator over others
    low: float  # low, high: limits, both allowed
    high: float
    reason: str  # of the limits
    find: Callable[[Sequence[Compared]], Estimate | None]  # the statistic; None where no flight tells it
    cause: str | None = None  # why the simulator differs where the limit is missed; None: the text says it
    # the simulator draws its numbers, and flights differ in them as widely: the limit is missed where the
    # whole interval lies outside it
    by_chance: bool = False
    scale: float = 1.0  # scale, unit: for the eye
    unit: str = ""

    @property
    def limit(self) -> str:
        """The limits as text."""
        low, high = (f"{self.scale * value:.4g}" for value in (self.low, self.high))
        if self.low == -np.inf:
            return f"≤ {high}{self.unit}"
        return f"≥ {low}{self.unit}" if self.high == np.inf else f"{low} to {high}{self.unit}"


class Verdict(NamedTuple):
    """A criterion and what was found: within its limits, or too far by chance, or missed."""

    criterion: Criterion
    found: Estimate | None
    word: str

    @property
    def met(self) -> bool:
        """Whether the flights do not contradict."""
        return self.word != MISSED

    @property
    def told(self) -> str:
        """What was found as text, with its interval."""
        if self.found is None:
            return "no flight tells"
        value, low, high = (f"{self.criterion.scale * each:.3g}" for each in self.found)
        interval = "" if np.isnan(self.found.low) else f" ({low} to {high})"
        return f"{value}{self.criterion.unit}{interval}"


def judge(flights: Sequence[Compared]) -> list[Verdict]:
    """Hold the flights against all criteria."""
    found = [(criterion, criterion.find(flights)) for criterion in CRITERIA]
    told = {criterion.part for criterion, estimate in found if estimate is not None}
    return [Verdict(c, estimate, _word(c, estimate, c.part in told)) for c, estimate in found]


def _word(criterion: Criterion, found: Estimate | None, part_told: bool) -> str:
    """Judge one; a speed that nobody flew is open, a part without any number is missed."""
    if found is None:
        return OPEN if part_told else MISSED
    if criterion.low <= found.value <= criterion.high:
        return MET
    outside = found.low > criterion.high or found.high < criterion.low
    return OPEN if criterion.by_chance and not outside else MISSED


def causes(verdicts: Sequence[Verdict]) -> list[str]:
    """Say in words what differs: named causes first, then what each part misses."""
    told = [
        v.criterion.cause.format(v.found.value)
        for v in verdicts
        if not v.met and v.found is not None and v.criterion.cause is not None
    ]
    for part in dict.fromkeys(v.criterion.part for v in verdicts):
        missed = [v for v in verdicts if not v.met and v.criterion.part == part and v.found is not None]
        plain = [
            f"{v.criterion.text}: {v.told}, limit {v.criterion.limit}"
            for v in missed
            if v.found is not None and v.criterion.cause is None
        ]
        if plain:
            told.append(f"{MEANING[part]}: " + "; ".join(plain))
        unknown = [
            v.criterion.text for v in verdicts if v.found is None and not v.met and v.criterion.part == part
        ]
        if unknown:
            told.append(f"{part} is not judged by any flight: " + "; ".join(unknown))
    return told


MEANING = {
    "open loop": "the recorded motor commands do not move the plant as they moved the vehicle",
    "closed loop": "the simulated firmware and vehicle do not fly the set-points as the recorded ones",
    "sensing": "the simulated own state is not as wrong as the recorded one",
}
_HALF = "a model that knows the motor commands must halve the error of one that knows nothing"
_TORQUE = (
    "torque that no command shows is integrated twice: 0.63 was reached, 0.25 with the recorded attitude"
)
OPEN_LOOP_MAX = {  # of the error of constant velocity: position, velocity
    0.1: ((0.5, _HALF), (0.5, _HALF)),
    0.25: ((0.5, _HALF), (0.5, _HALF)),
    0.5: ((0.5, _HALF), (0.75, _TORQUE)),
}
_SPEEDS = tuple(pairwise(SPEED_EDGES_M_S))
TRACKING_WITHIN = 0.25
SHUFFLED = "shuffled"
_NOTHING = "the motor commands tell nothing: in random order they predict as well"


def _open_loop(of: str, seconds: float, quantity: str) -> Callable[[Sequence[Compared]], Estimate | None]:
    """Ratio of the model's error to that of ``of``."""

    def find(flights: Sequence[Compared]) -> Estimate | None:
        found = [
            (getattr(own, quantity), getattr(random, quantity))
            for flight in flights
            if flight.open_loop is not None and flight.shuffled is not None
            for own, random in zip(flight.open_loop.horizons, flight.shuffled.horizons, strict=True)
            if own.seconds == seconds
        ]
        others = [random.model if of == SHUFFLED else getattr(own, of) for own, random in found]
        return over_flights(median_ratio, [own.model for own, _ in found], others)

    return find


def _thrust(flights: Sequence[Compared]) -> Estimate | None:
    return over_flights(np.median, [f.open_loop.thrust_ratio for f in flights if f.open_loop is not None])


def _closed_loop(
    statistic: Callable[..., Floats], value: Callable[[Flown], float]
) -> Callable[[Sequence[Compared]], Estimate | None]:
    """Statistic of a value of the simulated flights and the recorded ones."""

    def find(flights: Sequence[Compared]) -> Estimate | None:
        both = [f.closed_loop for f in flights if f.closed_loop is not None]
        return over_flights(statistic, [value(c.simulated) for c in both], [value(c.recorded) for c in both])

    return find


def tracking_m(flown: Flown) -> float:
    """Return the rms distance between position and set-point."""
    return math.hypot(flown.horizontal_m, flown.vertical_m)


def share_within(a: Floats, b: Floats, axis: int) -> Floats:
    """Share of flights where two numbers differ by at most ``TRACKING_WITHIN``."""
    return np.asarray((np.abs(a / b - 1.0) <= TRACKING_WITHIN).mean(axis=axis))


def median_difference(a: Floats, b: Floats, axis: int) -> Floats:
    """Median over flights of how much two numbers differ, as a share."""
    return np.asarray(np.median(np.abs(a / b - 1.0), axis=axis))


def _sensing(
    statistic: Callable[..., Floats], quantity: str, value: Callable[[Error], float]
) -> Callable[[Sequence[Compared]], Estimate | None]:
    """Statistic of a value of the simulated error and the recorded one."""

    def find(flights: Sequence[Compared]) -> Estimate | None:
        both = [f.sensing for f in flights if f.sensing is not None]
        pairs = [(getattr(s.simulated, quantity), getattr(s.recorded, quantity)) for s in both]
        return over_flights(statistic, [value(a) for a, _ in pairs], [value(b) for _, b in pairs])

    return find


def _at(band: int) -> Callable[[Error], float]:
    return lambda error: error.by_speed[band]


CRITERIA = (
    Criterion(
        "open loop", "thrust, plant / recording", 0.95, 1.05,
        "5 % of thrust are 3 % of PWM; airframes differ by 2.3 % (standard deviation)",
        _thrust, "the plant's thrust is {:.2f} times the recorded one",
    ),
    *(
        Criterion(
            "open loop", f"{name} after {seconds:g} s / {told}", -np.inf, limit,
            reason, _open_loop(of, seconds, quantity),
        )
        for seconds in HORIZONS_S
        for (quantity, name), (allowed, why) in zip(
            (("position_m", "position"), ("velocity_m_s", "velocity")), OPEN_LOOP_MAX[seconds], strict=True
        )
        for of, told, limit, reason in (
            ("constant_velocity", "constant velocity", allowed, why),
            ("ideal", "ideal body", 1.0, "lag, drag and battery must help, or they are wrong"),
        )
    ),
    *(
        Criterion(
            "open loop", f"{name} after 0.1 s / commands in random order", -np.inf, 0.8,
            "what the commands tell is their order", _open_loop(SHUFFLED, 0.1, quantity), cause,
        )
        for quantity, name, cause in (
            ("position_m", "position", _NOTHING),
            ("velocity_m_s", "velocity", None),
        )
    ),
    Criterion(
        "closed loop", "flights with tracking within 25 %", 0.8, np.inf,
        "two flights of the same path by the same vehicle differ by as much",
        _closed_loop(share_within, tracking_m), scale=100.0, unit=" %",
    ),
    Criterion(
        "closed loop", "PWM in hover, median difference", -np.inf, 0.03,
        "airframes differ by 2.3 % of thrust (standard deviation), 1.5 % of PWM",
        _closed_loop(median_difference, lambda flown: flown.duty), scale=100.0, unit=" %",
    ),
    Criterion(
        "closed loop", "saturated time / recorded", 0.5, 2.0,
        "it counts rare peaks: a percent of thrust changes it by a third",
        _closed_loop(ratio_of_means, lambda flown: flown.saturated), by_chance=True,
    ),
    *(
        Criterion(
            "sensing", f"{name} at {low:g} to {high:g} m/s / recorded", 0.8, 1.2,
            "a filter that is tuned to it then declares an envelope that is right to 20 %",
            _sensing(ratio_of_rms, name, _at(band)), by_chance=True,
        )
        for name in ("position", "velocity")
        for band, (low, high) in enumerate(_SPEEDS)
    ),
    *(
        Criterion(
            "sensing", f"delay of {name} - recorded", -0.005, 0.005,
            "half a sample of the recordings; 5 mm at 1 m/s",
            _sensing(difference_of_means, name, lambda error: error.delay_s), by_chance=True,
            scale=1000.0, unit=" ms",
        )
        for name in ("position", "velocity")
    ),
)  # fmt: skip
