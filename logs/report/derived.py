"""Values derived from the recorded ones: margin of the filter, errors of the estimates, tilt, faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flightstack.core.strategies.strategy import packaged_strategy_of
from flightstack.core.types import FilterStatus
from logs.reader.flight_data import Flight, Floats
from logs.verdict.types import Verdict

if TYPE_CHECKING:
    from logs.report.links import Stream

_RAN = (
    FilterStatus.SOLVED,
    FilterStatus.CLOSED_FORM,
    FilterStatus.INFEASIBLE,
    FilterStatus.CROWDED,
)
_NEAR_S = 0.02  # a true state farther in time than two ticks is not that of the step
BEGINS, ENDS = "Fault: ", "Fault over: "
_RELAYED = "vehicle: "  # prefix of the vehicle's messages in events of the onboard process
_ENOUGH = 200  # a page with more is not read


def held_margin_m(flight: Flight) -> Floats | None:
    """(n,) margin on h that the filter held at each step, m; NaN where it did not run.

    The step holds the slack s of the constraint at u*: s = g u* + rate * h_held + dh/dt. So h_held follows,
    and the margin is h - h_held. ``None`` without steps, without configuration,
    and for a filter that is not part of the package.
    """
    steps, config = flight.steps, flight.config
    if steps is None or config is None:
        return None
    strategy = packaged_strategy_of(config)
    if strategy is None:
        return None
    flow = np.einsum("ij,ij->i", steps.gradient, steps.filtered_enu_m_s)
    held_m = (steps.slack_m_s - flow - steps.dh_dt_m_s) / strategy.rate_1_s
    margin_m = np.where(np.isin(steps.filter_status, _RAN), steps.h_m - held_m, np.nan)
    return margin_m if np.isfinite(margin_m).any() else None


@dataclass(frozen=True)
class Errors:
    """What the controller used minus what was true, at its n steps; vectors (n, 3), NaN where not known."""

    t_s: Floats
    own_m: Floats
    target_m: Floats
    target_m_s: Floats
    h_m: Floats


def estimate_errors(flight: Flight) -> Errors | None:
    """Errors against the true states, which are put between their ticks linearly; ``None`` without them."""
    steps, truth = flight.steps, flight.truth
    if steps is None or truth is None or len(truth.t_s) < 2:
        return None
    gap_s = np.abs(truth.t_s[_nearest(truth.t_s, steps.t_s)] - steps.t_s)
    known = (gap_s <= _NEAR_S)[:, None]

    def at_steps(values: Floats) -> Floats:
        columns = [np.interp(steps.t_s, truth.t_s, column) for column in values.T]
        return np.where(known, np.column_stack(columns), np.nan)

    own = np.where(steps.own_valid[:, None], steps.own_position_enu_m, np.nan)
    target = np.where(steps.target_valid[:, None], steps.target_position_enu_m, np.nan)
    target_v = np.where(steps.target_valid[:, None], steps.target_velocity_enu_m_s, np.nan)
    h_m = np.where(steps.both_valid, steps.h_m, np.nan)
    return Errors(
        steps.t_s,
        own - at_steps(truth.position_enu_m),
        target - at_steps(truth.pad_position_enu_m),
        target_v - at_steps(truth.pad_velocity_enu_m_s),
        h_m - at_steps(truth.h_m[:, None])[:, 0],
    )


def root_mean_square(values: Floats) -> float | None:
    """Of the numbers among the values; ``None`` without any."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known * known))) if len(known) else None


def tilt_deg(flight: Flight) -> Floats | None:
    """(n,) angle between the true body's up and the vertical, degrees; ``None`` without true states."""
    if flight.truth is None:
        return None
    x, y = flight.truth.orientation[:, 0], flight.truth.orientation[:, 1]
    return np.asarray(np.degrees(np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))))


def _nearest(times: Floats, wanted: Floats) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    left = right - 1
    return np.where(wanted - times[left] <= times[right] - wanted, left, right)


class Side(NamedTuple):
    name: str
    flight: Flight
    verdict: Verdict
    streams: list[Stream]


class FaultSpan(NamedTuple):
    """One fault; times as in the flight, ``over`` is False for one that lasted to the end of the log."""

    text: str
    begin_s: float
    end_s: float
    over: bool


def fault_spans(flight: Flight) -> list[FaultSpan]:
    """Faults in order of their start; one reported by two processes counts once."""
    begun: dict[str, float] = {}
    found: list[FaultSpan] = []
    for event in flight.events:
        text = event.text.removeprefix(_RELAYED)
        if text.startswith(BEGINS):
            begun.setdefault(text.removeprefix(BEGINS), event.t_s)
        elif text.startswith(ENDS):
            name = text.removeprefix(ENDS)
            begin_s = begun.pop(name, None)
            if begin_s is not None:
                found.append(FaultSpan(name, begin_s, event.t_s, over=True))
    found += [FaultSpan(name, begin_s, flight.duration_s, over=False) for name, begin_s in begun.items()]
    return sorted(found, key=lambda span: span.begin_s)[:_ENOUGH]
