"""Figures over time of a flight, and of the members of a fleet.

Of a flight: barrier (paper Fig. 9a, 13a), velocities (9b-d, 13b-d), filter, errors, loop, ages. Of a fleet:
barrier values of the members, and distances of all pairs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from flightstack.core.types import FilterStatus
from logs.reader.flight_data import Flight, Floats, Steps
from logs.recorder.markers import COLORS, PAIR_COLORS
from logs.report.derived import Side, estimate_errors, held_margin_m, tilt_deg
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
    UNSAFE,
    Axis,
    axis_of,
    chart,
    line,
    low_envelope,
    marks,
    value_range,
    zero_s,
)
from logs.verdict.types import VIOLATION_LIMIT_M, Verdict
from logs.verdict.verdict import PairSeries

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
    zero, steps, truth = zero_s(flight), flight.steps, flight.truth
    traces: list[tuple[int, go.Scatter]] = []
    shown: list[tuple[Floats, Floats]] = []
    lowest: list[tuple[Floats, Floats, str, str]] = []  # times, lowest h, place (text) and symbol
    if steps is not None:
        t, h = steps.t_s - zero, np.where(steps.both_valid, steps.h_m, np.nan)
        shown.append((t, h))
        dash = "solid" if truth is None else "dash"
        traces.append((1, line(t, h, "h (estimate)", ESTIMATED, dash=dash, width=1.5)))
        if truth is None:
            outside = np.where((steps.d_m > flight.pad_radius_m) & (t >= 0.0), h, np.inf)
            lowest.append((t, outside, "outside the pad", "triangle-down"))
    if truth is not None:
        t, h = low_envelope(truth.t_s - zero, truth.h_min_m)
        shown.append((t, h))
        traces.append((1, line(t, h, "h (true, lowest between ticks)", TRUE, width=2.2)))
        t = truth.t_s - zero
        outside = np.where(t > 0.0, truth.h_min_outside_pad_m, np.inf)
        lowest.append((t, outside, "outside the pad", "triangle-down"))
        lowest.append((t, np.where(t > 0.0, truth.h_min_m, np.inf), "anywhere", "triangle-down-open"))
    if not shown or all(np.isnan(h).all() for _, h in shown):
        return None
    margin_m = held_margin_m(flight)
    if margin_m is not None and steps is not None and np.nanmax(margin_m) > _MARGIN_SEEN_M:
        traces.append((1, line(steps.t_s - zero, margin_m, "margin: lower limit of h", MARGIN, width=2)))
    figure = chart(
        axis_of(flight), 420, traces, {"title_text": "h [m]", "range": value_range(axis_of(flight), shown)}
    )
    for t, h, where, symbol in lowest:
        known = np.where(np.isfinite(h), h, np.inf)
        at = int(np.argmin(known))
        if np.isfinite(known[at]):
            name = f"lowest {where}: {h[at]:.4f} m".replace("-", "−")
            marker(figure, t[at], h[at], name, symbol, INK)
    figure.add_hline(0.0, line={"color": BOUNDARY, "width": 1.8})
    if verdict.started_safe is not False:
        figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    return figure


_Drawn = tuple[str, Floats, str, str, float]  # fields: name, velocity (n, 3), colour, dash, width


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
    traces, ranges = _components(flight, t, drawn, "vehicle (true)", LIMIT, width=1.0, visible="legendonly")
    ends = np.array([-zero_s(flight), flight.duration_s - zero_s(flight)])
    for row, (low, high) in enumerate(ranges, 1):
        if flight.velocity_max_m_s is not None:
            limit = flight.velocity_max_m_s[row - 1]
            low, high = min(low, -1.15 * limit), max(high, 1.15 * limit)
            for sign in (-1.0, 1.0):
                box = np.full(2, sign * limit)
                look = {"dash": "dashdot", "width": 1.0, "legendgroup": "box", "hoverinfo": "skip"}
                shown = row == 1 and sign > 0.0
                traces.append((row, line(ends, box, "admissible box", LIMIT, showlegend=shown, **look)))
        floor = low - 0.03 * (high - low)
        active = np.where(steps.barrier_active, floor, np.nan)  # drawn as a bar along the bottom
        look = {"width": 5, "legendgroup": "active", "hoverinfo": "skip"}
        traces.append((row, line(t, active, "barrier active", BOUNDARY, showlegend=row == 1, **look)))
        ranges[row - 1] = [floor - 0.02 * (high - low), high]
    return chart(axis_of(flight), 760, traces, *_of_axes(ranges), spacing=0.045)


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
    t = steps.t_s - zero_s(flight)
    traces, ranges = _components(flight, t, drawn, "flown (true)", FLOWN, width=1.4)
    return chart(axis_of(flight), 720, traces, *_of_axes(ranges), spacing=0.045)


def sent_m_s(steps: Steps) -> Floats:
    return np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)


def _components(
    flight: Flight, t: Floats, drawn: Sequence[_Drawn], true: str, color: str, **look: Any
) -> tuple[list[tuple[int, go.Scatter]], list[list[float]]]:
    """Return the velocities of each axis with its row, the true ones included, and the range of each row."""
    traces, ranges = [], []
    for row in (1, 2, 3):
        for name, values, its_color, dash, width in drawn:
            style = {"dash": dash, "width": width, "legendgroup": name, "showlegend": row == 1}
            traces.append((row, line(t, values[:, row - 1], name, its_color, **style)))
        if flight.truth is not None:
            t_true, v_true = flight.truth.t_s - zero_s(flight), flight.truth.velocity_enu_m_s[:, row - 1]
            style = {"legendgroup": "true", "showlegend": row == 1, **look}
            traces.append((row, line(t_true, v_true, true, color, **style)))
        ranges.append(value_range(axis_of(flight), [(t, values[:, row - 1]) for _, values, *_ in drawn]))
    return traces, ranges


def _of_axes(ranges: Sequence[list[float]]) -> list[dict[str, Any]]:
    return [{"title_text": f"{name} [m/s]", "range": shown} for name, shown in zip(AXES, ranges, strict=True)]


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
        axis_of(flight), 480, traces, {"title_text": "change [m/s]", "rangemode": "tozero"},
        {"title_text": "slack [m/s]", "range": value_range(axis_of(flight), [(t, slack)])}, spacing=0.07,
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
        axes.append({"title_text": title, "range": value_range(axis_of(flight), [(t, y) for y in columns])})
    h_mm = 1e3 * errors.h_m
    traces.append((3, line(t, h_mm, "h", INK, width=1.3)))
    axes.append({"title_text": "h [mm]", "range": value_range(axis_of(flight), [(t, h_mm)])})
    return chart(axis_of(flight), 640, traces, *axes, spacing=0.05)


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
    return chart(axis_of(flight), 420, traces, tilt_axis, {"title_text": "battery [V]"}, spacing=0.08)


_WALL_US = [m * 10**n for n in range(6) for m in (1, 2, 5)]  # tick labels of the wall time axis, us


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
    return chart(axis_of(flight), 480, traces, {"title_text": "period [ms]"}, wall_axis, spacing=0.07)


def data_age(flight: Flight) -> go.Figure | None:
    """Draw the age of target and vehicle state at each tick, with the limits of the configuration."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.target_age_s).any():
        return None
    t = steps.t_s - zero_s(flight)
    ages, traces, limits = [], [], []
    for name, values, color in (
        ("target state", steps.target_age_s, TARGET),
        ("own state", steps.own_age_s, TRUE),
    ):
        age_ms = np.where(np.isfinite(values), values, np.nan) * 1e3
        ages.append((t, age_ms))
        traces.append((1, line(t, age_ms, name, color, width=1.4)))
    low, high = value_range(axis_of(flight), ages)
    if flight.config is not None:
        checks = flight.config.checks
        limits = [("target", "right", checks.target_age_max_s), ("own", "left", checks.own_age_max_s)]
        high = max(high, *(1.1e3 * limit_s for *_, limit_s in limits))
    refused = np.flatnonzero(np.diff(steps.target_rejected) > 0) + 1
    if len(refused):
        look = {"symbol": "x-thin", "size": 8, "line": {"color": BOUNDARY, "width": 1.5}}
        traces.append((1, marks(refused, t, np.zeros_like(t), "sample refused", **look)))
    figure = chart(axis_of(flight), 380, traces, {"title_text": "age at the tick [ms]", "range": [low, high]})
    for name, side, limit_s in limits:
        figure.add_hline(
            limit_s * 1e3, line={"color": LIMIT, "width": 1, "dash": "dash"},
            annotation={"text": f"limit, {name} state", "font": {"size": 11, "color": LIMIT}},
            annotation_position=f"top {side}",
        )  # fmt: skip
    return figure


_DASHES = ("solid", "dash", "dot")  # line styles that distinguish pairs of equal colour
# ellipsoid norm at which the distance axis ends at the earliest, unless all values are smaller
_MEASURE_SHOWN = 6.0
_LIMITS_SHOWN = 3  # maximum number of pairs whose limit along the connecting line is drawn
_PAIRS_SHOWN = 8  # number of pairs that are visible at first: the nearest ones
_LISTED, _LISTED_PX = 8, 22  # number of pair names per line of the legend; height of a line, pixels


def best_h(flight: Flight) -> tuple[Floats, Floats] | None:
    """Return h since the landing began: the true h if known, or else the controller's h."""
    truth, steps, start_s = flight.truth, flight.steps, flight.landing_start_s or 0.0
    if truth is not None:
        t_s, h_m = truth.t_s, truth.h_min_m
    elif steps is not None:
        t_s, h_m = steps.t_s, np.where(steps.both_valid, steps.h_m, np.nan)
    else:
        return None
    return low_envelope(t_s[t_s >= start_s], h_m[t_s >= start_s])


def barriers(sides: Sequence[Side], axis: Axis) -> go.Figure | None:
    """Draw h of each flight over time, with the boundary and the violation limit."""
    traces, shown = [], []
    for number, side in enumerate(sides):
        found = best_h(side.flight)
        if found is None or not np.isfinite(found[1]).any():
            continue
        t, y = found[0] + side.offset_s, np.where(np.isfinite(found[1]), found[1], np.nan)
        shown.append((t, y))
        traces.append((1, line(t, y, side.name, COLORS[number % len(COLORS)], width=1.6)))
    if not shown:
        return None
    y_axis = {"title_text": "h [m]", "range": value_range(axis, shown)}
    figure = chart(axis, 360, traces, y_axis, hovermode="closest")
    figure.add_hrect(y0=-100.0, y1=0.0, fillcolor=UNSAFE, line={"width": 0}, layer="below")
    figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    return figure


def distances(pairs: Sequence[PairSeries], axis: Axis) -> go.Figure | None:
    """Draw the distance of each pair over time, as ellipsoid norm and in m; ``None`` without pairs.

    If there are many pairs, only the nearest ones are visible at first.
    """
    if not pairs:
        return None
    traces, many = [], len(pairs) > _LIMITS_SHOWN
    nearest = {pair.name for pair in sorted(pairs, key=_nearest)[:_PAIRS_SHOWN]}
    for number, pair in enumerate(pairs):
        color, dash = PAIR_COLORS[number % len(PAIR_COLORS)], _DASHES[number // len(PAIR_COLORS) % 3]
        for row, values in ((1, pair.measure), (2, pair.distance_m)):
            for both, width, opacity in ((pair.flying, 2.2, 1.0), (~pair.flying, 1.2, 0.35)):
                t_s, shown = low_envelope(pair.t_s, np.where(both, values, np.nan))
                look = {
                    "width": width, "dash": dash, "opacity": opacity, "legendgroup": pair.name,
                    "showlegend": row == 1 and opacity == 1.0, "connectgaps": False,
                    "visible": True if pair.name in nearest else "legendonly",
                }  # fmt: skip
                traces.append((row, line(t_s, shown, pair.name, color, **look)))
        if not many:
            limit_m = np.where(pair.flying, pair.distance_m / np.maximum(pair.measure, 1e-9), np.nan)
            traces.append((2, line(pair.t_s, limit_m, f"limit of {pair.name}", color, dash="dot", width=1.2)))
    more_px = _LISTED_PX * ((len(pairs) - 1) // _LISTED)
    top = min(
        max(_MEASURE_SHOWN, 2.0 * min(float(p.measure.min()) for p in pairs)),
        max(float(p.measure.max()) for p in pairs),
    )
    measure = {"title_text": "in the ellipsoid's measure [1]", "range": [0.0, 1.05 * top]}
    distance = {"title_text": "distance [m]", "rangemode": "tozero"}
    figure = chart(
        axis, 620 + more_px, traces, measure, distance, spacing=0.06, hovermode="closest", legend_px=more_px
    )
    figure.add_hrect(y0=0.0, y1=1.0, fillcolor=UNSAFE, line={"width": 0}, layer="below", row=1, col=1)
    figure.add_hline(1.0, line={"color": BOUNDARY, "width": 1.5}, row=1, col=1)
    return figure


def _nearest(pair: PairSeries) -> float:
    return float(pair.measure[pair.flying].min()) if pair.flying.any() else math.inf
