"""Figures over time: barrier (paper Fig. 9a, 13a), velocities (9b-d, 13b-d), filter, errors, loop, ages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from flightstack.core.types import FilterStatus
from logs.reader.flight_data import Flight, Floats, Steps
from logs.report.derived import estimate_errors, held_margin_m, tilt_deg
from logs.report.space import marker
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    ESTIMATED,
    FILTERED,
    FLOWN,
    INK,
    LIMIT,
    MARGIN,
    NOMINAL,
    TARGET,
    TRUE,
    add_line,
    chart,
    line,
    low_envelope,
    marks,
    over_time,
    rows_of,
    value_range,
    zero_s,
)
from logs.verdict.types import VIOLATION_LIMIT_M, Verdict

_MARGIN_SEEN_M = 1e-4  # smallest drawn margin, m; without a margin only rounding remains
AXES = ("x, east", "y, north", "z, up")
_ODD = {
    FilterStatus.CLOSED_FORM: ("exact projection used", "circle"),
    FilterStatus.INFEASIBLE: ("no velocity satisfies it", "x"),
    FilterStatus.REJECTED: ("nothing usable", "cross"),
    FilterStatus.CROWDED: ("constraints of other vehicles relaxed", "triangle-up"),
}


def barrier_over_time(flight: Flight, verdict: Verdict) -> go.Figure | None:
    """Draw h over time with h = 0, the violation limit, and the lowest h outside the pad."""
    zero, figure = zero_s(flight), go.Figure()
    shown: list[tuple[Floats, Floats]] = []
    if flight.steps is not None:
        t, h = flight.steps.t_s - zero, np.where(flight.steps.both_valid, flight.steps.h_m, np.nan)
        shown.append((t, h))
        dash = "solid" if flight.truth is None else "dash"
        figure.add_trace(line(t, h, "h (estimate)", ESTIMATED, dash=dash, width=1.5))
    if flight.truth is not None:
        t, h = low_envelope(flight.truth.t_s - zero, flight.truth.h_min_m)
        shown.append((t, h))
        figure.add_trace(line(t, h, "h (true, lowest between ticks)", TRUE, width=2.2))
        outside = np.where(flight.truth.t_s > zero, flight.truth.h_min_outside_pad_m, np.inf)
        _mark_lowest(figure, flight.truth.t_s - zero, outside, "outside the pad", "triangle-down")
        anywhere = np.where(flight.truth.t_s > zero, flight.truth.h_min_m, np.inf)
        _mark_lowest(figure, flight.truth.t_s - zero, anywhere, "anywhere", "triangle-down-open")
    elif flight.steps is not None:
        outside = (flight.steps.d_m > flight.pad_radius_m) & (flight.steps.t_s >= zero)
        h_m = np.where(outside, flight.steps.h_m, np.inf)
        _mark_lowest(figure, flight.steps.t_s - zero, h_m, "outside the pad", "triangle-down")
    if not shown or all(np.isnan(h).all() for _, h in shown):
        return None
    margin_m = held_margin_m(flight)
    if margin_m is not None and flight.steps is not None and np.nanmax(margin_m) > _MARGIN_SEEN_M:
        figure.add_trace(line(flight.steps.t_s - zero, margin_m, "margin: lower limit of h", MARGIN, width=2))
    figure.add_hline(0.0, line={"color": BOUNDARY, "width": 1.8})
    if verdict.started_safe is not False:
        figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    over_time(figure, flight, 420)
    figure.update_yaxes(title_text="h [m]", range=value_range(flight, shown))
    return figure


def _mark_lowest(figure: go.Figure, t: Floats, h: Floats, where: str, symbol: str) -> None:
    known = np.where(np.isfinite(h), h, np.inf)
    at = int(np.argmin(known))
    if not np.isfinite(known[at]):
        return
    name = f"lowest {where}: {h[at]:.4f} m".replace("-", "−")
    marker(figure, t[at], h[at], name, symbol, INK)


_Drawn = tuple[str, Floats, str, str, float]  # fields: name, velocity (n, 3), colour, dash, width
_Extra = Callable[[go.Figure, int, list[float]], list[float]]  # draws on an axis, returns a wider range


def velocities(flight: Flight) -> go.Figure | None:
    """Draw nominal, filtered and sent velocity on each axis with the admissible box."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.nominal_enu_m_s).any():
        return None
    t = steps.t_s - zero_s(flight)
    drawn = (
        ("nominal u'", steps.nominal_enu_m_s, NOMINAL, "dash", 1.6),
        ("filtered u*", steps.filtered_enu_m_s, FILTERED, "solid", 2.4),
        ("sent, after slew limit and gate", sent_m_s(steps), COMMAND, "dot", 2.0),
    )
    true = ("vehicle (true)", LIMIT, {"width": 1.0, "visible": "legendonly"})

    def box_and_bar(figure: go.Figure, axis: int, values: list[float]) -> list[float]:
        low, high = values
        legend = axis == 0
        if flight.velocity_max_m_s is not None:
            limit = flight.velocity_max_m_s[axis]
            low, high = min(low, -1.15 * limit), max(high, 1.15 * limit)
            _limits(figure, flight, limit, axis + 1, legend)
        floor = low - 0.03 * (high - low)
        active = np.where(steps.barrier_active, floor, np.nan)  # a bar along the bottom
        add_line(
            figure, axis + 1, t, active, "barrier active", BOUNDARY, width=5, legendgroup="active",
            showlegend=legend, hoverinfo="skip",
        )  # fmt: skip
        return [floor - 0.02 * (high - low), high]

    return _axes(flight, t, drawn, true, 760, box_and_bar)


def tracking(flight: Flight) -> go.Figure | None:
    """Draw wanted velocity, set-point after corrections, and flown velocity on each axis."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.wanted_enu_m_s).any():
        return None
    own = np.where(steps.own_valid[:, None], steps.own_velocity_enu_m_s, np.nan)
    drawn = (
        ("wanted", steps.wanted_enu_m_s, FILTERED, "solid", 2.2),
        ("sent set-point", sent_m_s(steps), COMMAND, "dot", 2.0),
        ("flown, by its own estimate", own, ESTIMATED, "solid", 1.3),
    )
    true = ("flown (true)", FLOWN, {"width": 1.4})
    return _axes(flight, steps.t_s - zero_s(flight), drawn, true, 720, lambda figure, axis, values: values)  # noqa: ARG005


def sent_m_s(steps: Steps) -> Floats:
    return np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)


def _axes(
    flight: Flight, t: Floats, drawn: Sequence[_Drawn], true: tuple[str, str, dict[str, Any]],
    height_px: int, extra: _Extra,
) -> go.Figure:  # fmt: skip
    """Draw the velocities of each axis in a row; the true one, if known, by name, colour and style."""
    figure = rows_of(3, 0.045)
    for axis in range(3):
        row, legend = axis + 1, axis == 0
        for name, values, color, dash, width in drawn:
            add_line(
                figure, row, t, values[:, axis], name, color, dash=dash, width=width, legendgroup=name,
                showlegend=legend,
            )  # fmt: skip
        if flight.truth is not None:
            name, color, look = true
            t_true, v_true = flight.truth.t_s - zero_s(flight), flight.truth.velocity_enu_m_s[:, axis]
            add_line(figure, row, t_true, v_true, name, color, legendgroup="true", showlegend=legend, **look)
        shown = value_range(flight, [(t, values[:, axis]) for _, values, _, _, _ in drawn])
        shown = extra(figure, axis, shown)
        figure.update_yaxes(title_text=f"{AXES[axis]} [m/s]", range=shown, row=row, col=1)
    over_time(figure, flight, height_px, rows=3)
    return figure


def _limits(figure: go.Figure, flight: Flight, limit_m_s: float, row: int, legend: bool) -> None:
    ends = np.array([-zero_s(flight), flight.duration_s - zero_s(flight)])
    for sign in (-1.0, 1.0):
        add_line(
            figure, row, ends, np.full(2, sign * limit_m_s), "admissible box", LIMIT, dash="dashdot",
            width=1.0, legendgroup="box", showlegend=legend and sign > 0.0, hoverinfo="skip",
        )  # fmt: skip


def filter_activity(flight: Flight) -> go.Figure | None:
    """Draw the change of velocity by the barrier and the slack of its constraint; mark unusual results."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.slack_m_s).any():
        return None
    t = steps.t_s - zero_s(flight)
    ran = np.isfinite(steps.slack_m_s)
    changed = np.where(ran, np.linalg.norm(steps.filtered_enu_m_s - steps.nominal_enu_m_s, axis=1), np.nan)
    slack = np.where(ran, steps.slack_m_s, np.nan)
    active = np.where(steps.barrier_active, 0.0, np.nan)
    traces = [
        (1, line(t, changed, "change |u* − u'|", FILTERED, width=1.8)),
        (2, line(t, slack, "slack of the constraint at u*", COMMAND, width=1.6)),
        (2, line(t, active, "barrier active", BOUNDARY, width=5, hoverinfo="skip")),
    ]
    for status, (name, symbol) in _ODD.items():
        at = np.flatnonzero(steps.filter_status == status)
        if len(at):
            traces.append((2, marks(at, t, slack, name, symbol=symbol, size=7, color=BOUNDARY)))
    return chart(
        flight, 480, 0.07, traces, {"title_text": "change [m/s]", "rangemode": "tozero"},
        {"title_text": "slack [m/s]", "range": value_range(flight, [(t, slack)])},
    )  # fmt: skip


def estimate_error(flight: Flight) -> go.Figure | None:
    """Draw estimate minus truth of vehicle position, target position and h; needs true states."""
    errors = estimate_errors(flight)
    if errors is None or not (np.isfinite(errors.own_m).any() or np.isfinite(errors.target_m).any()):
        return None
    t = errors.t_s - zero_s(flight)
    looks = (("east", NOMINAL), ("north", TRUE), ("up", COMMAND))
    traces, axes = [], []
    for row, title, values in ((1, "vehicle [mm]", errors.own_m), (2, "target [mm]", errors.target_m)):
        columns = 1e3 * values.T
        for y, (name, color) in zip(columns, looks, strict=True):
            look = {"width": 1.3, "legendgroup": name, "showlegend": row == 1}
            traces.append((row, line(t, y, name, color, **look)))
        axes.append({"title_text": title, "range": value_range(flight, [(t, y) for y in columns])})
    h_mm = 1e3 * errors.h_m
    traces.append((3, line(t, h_mm, "h", INK, width=1.3)))
    axes.append({"title_text": "h [mm]", "range": value_range(flight, [(t, h_mm)])})
    return chart(flight, 640, 0.05, traces, *axes)


def vehicle_state(flight: Flight) -> go.Figure | None:
    """Draw tilt and battery of the true vehicle; needs true states."""
    truth, tilt = flight.truth, tilt_deg(flight)
    if truth is None or tilt is None or not len(tilt):
        return None
    t = truth.t_s - zero_s(flight)
    off = np.where(truth.motors_running, np.nan, 0.0)
    traces = [
        (1, line(t, tilt, "tilt", TRUE, width=1.4)),
        (2, line(t, truth.battery_v, "battery", TARGET, width=1.4)),
        (1, line(t, off, "motors off", LIMIT, width=5, hoverinfo="skip")),
    ]
    tilt_axis = {"title_text": "tilt [°]", "rangemode": "tozero"}
    return chart(flight, 420, 0.08, traces, tilt_axis, {"title_text": "battery [V]"})


_WALL_US = [m * 10**n for n in range(6) for m in (1, 2, 5)]  # labels of the axis of wall times


def loop_timing(flight: Flight) -> go.Figure | None:
    timing = flight.timing
    if timing is None:
        return None
    t, period_ms = timing.t_s - zero_s(flight), timing.period_s * 1e3
    traces = [(1, line(t, period_ms, "period", TRUE, width=1.2))]
    missed = np.flatnonzero(np.diff(timing.overruns) > 0) + 1
    if len(missed):
        traces.append((1, marks(missed, t, period_ms, "overrun", symbol="x", size=8, color=BOUNDARY)))
    solve_us = np.where(timing.solve_s > 0.0, timing.solve_s * 1e6, np.nan)  # 0: the program did not run
    late_us, hidden = timing.lateness_s * 1e6, "legendonly"
    traces += [
        (2, line(t, timing.exec_s * 1e6, "whole tick", COMMAND, width=1.4)),
        (2, line(t, solve_us, "quadratic program", NOMINAL, width=1.4)),
        (2, line(t, late_us, "start after deadline", LIMIT, width=1.0, visible=hidden)),
    ]
    wall_axis = {"title_text": "wall time [µs]", "type": "log", "tickvals": _WALL_US}
    return chart(flight, 480, 0.07, traces, {"title_text": "period [ms]"}, wall_axis)


def data_age(flight: Flight) -> go.Figure | None:
    """Draw the age of target and vehicle state at each tick, with the limits of the configuration."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.target_age_s).any():
        return None
    t, figure = steps.t_s - zero_s(flight), go.Figure()
    ages = []
    for name, values, color in (
        ("target state", steps.target_age_s, TARGET),
        ("own state", steps.own_age_s, TRUE),
    ):
        age_ms = np.where(np.isfinite(values), values, np.nan) * 1e3
        ages.append((t, age_ms))
        figure.add_trace(line(t, age_ms, name, color, width=1.4))
    low, high = value_range(flight, ages)
    if flight.config is not None:
        limits = {"target": flight.config.checks.target_age_max_s, "own": flight.config.checks.own_age_max_s}
        for side, (name, limit_s) in zip(("right", "left"), limits.items(), strict=True):
            figure.add_hline(
                limit_s * 1e3, line={"color": LIMIT, "width": 1, "dash": "dash"},
                annotation={"text": f"limit, {name} state", "font": {"size": 11, "color": LIMIT}},
                annotation_position=f"top {side}",
            )  # fmt: skip
            high = max(high, 1.1e3 * limit_s)
    refused = np.flatnonzero(np.diff(steps.target_rejected) > 0) + 1
    if len(refused):
        thick = {"color": BOUNDARY, "width": 1.5}
        at_zero = np.zeros_like(t)
        figure.add_trace(marks(refused, t, at_zero, "sample refused", symbol="x-thin", size=8, line=thick))
    over_time(figure, flight, 380)
    figure.update_yaxes(title_text="age at the tick [ms]", range=[low, high])
    return figure
