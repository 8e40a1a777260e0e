"""All figures of the report, in order, each with what it shows and where its numbers come from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from logs.flight_data import Flight
from logs.report_series import barrier_over_time, data_age, loop_timing, velocities
from logs.report_space import altitude_over_distance, plan_view, trajectory_3d
from logs.verdict_types import Verdict

_PAD = 1  # contact bit of TrueState: vehicle on the top of the pad


@dataclass(frozen=True)
class Panel:
    """One figure with its words; ``figure`` is ``None`` if the log has nothing to draw."""

    key: str
    title: str
    paper: str
    note: str
    figure: go.Figure | None


def panels(flight: Flight, verdict: Verdict) -> list[Panel]:
    """Draw everything this log holds."""
    touch = touch_index(flight)
    both = "Solid: true states of the simulator. Dashed: the vehicle's own estimate."
    source = both if flight.truth is not None else "The vehicle's own estimate; the log holds no true states."
    edge = (
        "" if flight.barrier is not None else " The log does not say which barrier was flown; none is drawn."
    )
    return [
        Panel(
            "relative", "Landing relative to the pad, over the barrier", "Fig. 7, 10",
            f"{source} Surface: h = 0; unsafe below it.{edge}", trajectory_3d(flight, touch),
        ),
        Panel(
            "altitude", "Relative altitude over horizontal distance", "Fig. 8, 11",
            f"{source} Shaded: unsafe, h < 0.{edge}", altitude_over_distance(flight, touch),
        ),
        Panel(
            "barrier", "Barrier value over time", "Fig. 9a, 13a",
            f"{_barrier_source(flight)} Dotted: −5 mm, the limit of a violation outside the pad.",
            barrier_over_time(flight, verdict),
        ),
        Panel(
            "velocity", "Velocity: nominal, filtered, sent", "Fig. 9b–d, 13b–d",
            _VELOCITY + (_SWITCH if flight.truth is not None else ""),
            velocities(flight),
        ),
        Panel("plan", "Paths from above", "Fig. 12", f"{source} {_PLAN}", plan_view(flight, touch)),
        Panel("timing", "Loop timing", "", _timing_note(flight), loop_timing(flight)),
        Panel("age", "Age of the data at each tick", "", _age_note(flight), data_age(flight)),
    ]  # fmt: skip


_VELOCITY = (
    "Computed by the controller from its estimates. The bar at the bottom shows when the barrier changed the "
    "command."
)
_SWITCH = " The vehicle's true velocity can be switched on in the legend."
_PLAN = "Circles: where the landing began. Triangle: first contact with the pad. Squares: end of the log."


def touch_index(flight: Flight) -> int | None:
    """Index of the first true state with contact to the pad since the landing began."""
    truth, start_s = flight.truth, flight.landing_start_s
    if truth is None or start_s is None:
        return None
    found = np.flatnonzero((truth.contacts & _PAD > 0) & (truth.t_s > start_s))
    return int(found[0]) if len(found) else None


def _barrier_source(flight: Flight) -> str:
    if flight.truth is None:
        return "h as the controller computed it from its estimates; the log holds no true states."
    return (
        "Solid: h from the true states, the lowest of the physics steps between two ticks. "
        "Dashed: h as the controller computed it."
    )


def _timing_note(flight: Flight) -> str:
    timing = flight.timing
    if timing is None or len(timing.period_s) < 3:
        return "No loop timing."
    period_s = timing.period_s[2:]  # the first period is none, the second one may carry the start
    period_s = period_s[np.isfinite(period_s)]
    exec_us = timing.exec_s[np.isfinite(timing.exec_s)] * 1e6
    p50, p99 = (float(v) for v in np.percentile(exec_us, (50, 99)))
    text = (
        f"Wall clock. Period mean {period_s.mean() * 1e3:.3f} ms, standard deviation "
        f"{period_s.std() / period_s.mean() * 100:.2f} %; whole tick median {p50:.0f} µs, 99th percentile "
        f"{p99:.0f} µs; overruns {int(timing.overruns[-1])}; log records dropped "
        f"{int(timing.feed_dropped[-1])}."
    )
    if flight.metadata.get("run", {}).get("mode") == "lockstep":
        text += " The run was in lockstep, as fast as the machine can: its period is not that of a flight."
    return text


def _age_note(flight: Flight) -> str:
    steps = flight.steps
    if steps is None:
        return "No controller steps."
    received = 0 if flight.target is None else len(flight.target.t_s)
    return (
        f"As the controller saw it. Target samples received {received}, accepted "
        f"{int(steps.target_accepted[-1])}, "
        f"refused {int(steps.target_rejected[-1])}."
    )
