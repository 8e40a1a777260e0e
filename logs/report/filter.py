"""Figures of the filter and what became of its wish: activity, velocities flown, errors, the vehicle."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from flightstack.core.types import FilterStatus
from logs.reader.flight_data import Flight, Floats, Steps
from logs.report.derived import estimate_errors, tilt_deg
from logs.report.series import AXES, value_range
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    ESTIMATED,
    FILTERED,
    FLOWN,
    INK,
    LIMIT,
    NOMINAL,
    TARGET,
    TRUE,
    add_phases,
    layout,
    light,
    line,
    thin,
    time_axis,
    zero_s,
)

_ODD = {
    FilterStatus.CLOSED_FORM: ("exact projection used", "circle"),
    FilterStatus.INFEASIBLE: ("no velocity satisfies it", "x"),
    FilterStatus.REJECTED: ("nothing usable", "cross"),
}


def filter_activity(flight: Flight) -> go.Figure | None:
    """How much the barrier changes the velocity, and what is left of its constraint; odd results as marks."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.slack_m_s).any():
        return None
    t = steps.t_s - zero_s(flight)
    ran = np.isfinite(steps.slack_m_s)
    changed = np.where(ran, np.linalg.norm(steps.filtered_enu_m_s - steps.nominal_enu_m_s, axis=1), np.nan)
    slack = np.where(ran, steps.slack_m_s, np.nan)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.07)
    figure.add_trace(line(t, changed, "change |u* − u'|", FILTERED, width=1.8), row=1, col=1)
    figure.add_trace(line(t, slack, "left of the constraint at u*", COMMAND, width=1.6), row=2, col=1)
    active = np.where(steps.barrier_active, 0.0, np.nan)
    figure.add_trace(line(t, active, "barrier active", BOUNDARY, width=5, hoverinfo="skip"), row=2, col=1)
    for status, (name, symbol) in _ODD.items():
        at = np.flatnonzero(steps.filter_status == status)
        if len(at):
            _marks(figure, t[at[thin(len(at))]], slack[at[thin(len(at))]], name, symbol)
    layout(figure, 480)
    add_phases(figure, flight, rows=2)
    time_axis(figure, flight, rows=2)
    figure.update_yaxes(title_text="change [m/s]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="left [m/s]", range=value_range(flight, [(t, slack)]), row=2, col=1)
    return figure


def _marks(figure: go.Figure, t: Floats, y: Floats, name: str, symbol: str) -> None:
    style = {"symbol": symbol, "size": 7, "color": BOUNDARY}
    trace = go.Scatter(x=light(t), y=light(y), mode="markers", name=name, marker=style)
    figure.add_trace(trace, row=2, col=1)


def tracking(flight: Flight) -> go.Figure | None:
    """Velocity wanted, set-point after corrections, and velocity flown, of each axis."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.wanted_enu_m_s).any():
        return None
    zero = zero_s(flight)
    t = steps.t_s - zero
    sent = np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)
    own = np.where(steps.own_valid[:, None], steps.own_velocity_enu_m_s, np.nan)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.045)
    for axis in range(3):
        row, legend = axis + 1, axis == 0
        shown = [(t, values[:, axis]) for values in (steps.wanted_enu_m_s, sent, own)]
        looks = (("wanted", FILTERED, "solid", 2.2), ("set-point on the wire", COMMAND, "dot", 2.0),
                 ("flown, by its own estimate", ESTIMATED, "solid", 1.3))  # fmt: skip
        for (_, values), (name, color, dash, width) in zip(shown, looks, strict=True):
            trace = line(t, values, name, color, dash=dash, width=width, legendgroup=name, showlegend=legend)
            figure.add_trace(trace, row=row, col=1)
        if flight.truth is not None:
            true = flight.truth.velocity_enu_m_s[:, axis]
            trace = line(
                flight.truth.t_s - zero, true, "flown (true)", FLOWN, width=1.4, legendgroup="true",
                showlegend=legend,
            )  # fmt: skip
            figure.add_trace(trace, row=row, col=1)
        figure.update_yaxes(
            title_text=f"{AXES[axis]} [m/s]", range=value_range(flight, shown), row=row, col=1
        )
    layout(figure, 720)
    add_phases(figure, flight, rows=3)
    time_axis(figure, flight, rows=3)
    return figure


def estimate_error(flight: Flight) -> go.Figure | None:
    """Estimate minus truth: own position, target position, and h; needs true states."""
    errors = estimate_errors(flight)
    if errors is None or not (np.isfinite(errors.own_m).any() or np.isfinite(errors.target_m).any()):
        return None
    t = errors.t_s - zero_s(flight)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    looks = (("east", NOMINAL), ("north", TRUE), ("up", COMMAND))
    for row, values in ((1, errors.own_m), (2, errors.target_m)):
        for axis, (name, color) in enumerate(looks):
            trace = line(
                t, 1e3 * values[:, axis], name, color, width=1.3, legendgroup=name, showlegend=row == 1
            )
            figure.add_trace(trace, row=row, col=1)
        shown = [(t, 1e3 * values[:, axis]) for axis in range(3)]
        figure.update_yaxes(range=value_range(flight, shown), row=row, col=1)
    figure.add_trace(line(t, 1e3 * errors.h_m, "h", INK, width=1.3), row=3, col=1)
    figure.update_yaxes(range=value_range(flight, [(t, 1e3 * errors.h_m)]), row=3, col=1)
    for row, title in ((1, "vehicle [mm]"), (2, "target [mm]"), (3, "h [mm]")):
        figure.update_yaxes(title_text=title, row=row, col=1)
    layout(figure, 640)
    add_phases(figure, flight, rows=3)
    time_axis(figure, flight, rows=3)
    return figure


def vehicle_state(flight: Flight) -> go.Figure | None:
    """Tilt and battery of the true vehicle; needs true states."""
    truth, tilt = flight.truth, tilt_deg(flight)
    if truth is None or tilt is None or not len(tilt):
        return None
    t = truth.t_s - zero_s(flight)
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    figure.add_trace(line(t, tilt, "tilt", TRUE, width=1.4), row=1, col=1)
    figure.add_trace(line(t, truth.battery_v, "battery", TARGET, width=1.4), row=2, col=1)
    off = np.where(truth.motors_running, np.nan, 0.0)
    figure.add_trace(line(t, off, "motors off", LIMIT, width=5, hoverinfo="skip"), row=1, col=1)
    layout(figure, 420)
    add_phases(figure, flight, rows=2)
    time_axis(figure, flight, rows=2)
    figure.update_yaxes(title_text="tilt [°]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="battery [V]", row=2, col=1)
    return figure


def share_active(steps: Steps) -> float | None:
    """Share of the ticks with a filter in which the barrier changed the velocity; ``None`` without any."""
    ran = np.isfinite(steps.slack_m_s)
    return float(steps.barrier_active[ran].mean()) if ran.any() else None
