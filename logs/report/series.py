"""Figures over time: barrier with its margin (paper Fig. 9a, 13a), velocities (9b-d, 13b-d)."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from logs.reader.flight_data import Flight, Floats, Steps
from logs.report.derived import held_margin_m
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    ESTIMATED,
    FILTERED,
    INK,
    LIMIT,
    MARGIN,
    NOMINAL,
    TRUE,
    add_phases,
    layout,
    line,
    low_envelope,
    shown_range,
    time_axis,
    zero_s,
)
from logs.verdict.types import VIOLATION_LIMIT_M, Verdict

_MARGIN_SEEN_M = 1e-4  # m; a filter without a margin has none up to rounding
AXES = ("x, east", "y, north", "z, up")


def barrier_over_time(flight: Flight, verdict: Verdict) -> go.Figure | None:
    """h over time with h = 0, the violation limit, and the lowest h outside the pad."""
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
        figure.add_trace(
            line(flight.steps.t_s - zero, margin_m, "margin: h may not go below", MARGIN, width=2)
        )
    figure.add_hline(0.0, line={"color": BOUNDARY, "width": 1.8})
    if verdict.started_safe is not False:
        figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    layout(figure, 420)
    add_phases(figure, flight)
    time_axis(figure, flight)
    figure.update_yaxes(title_text="h [m]", range=value_range(flight, shown))
    return figure


def _mark_lowest(figure: go.Figure, t: Floats, h: Floats, where: str, symbol: str) -> None:
    known = np.where(np.isfinite(h), h, np.inf)
    at = int(np.argmin(known))
    if not np.isfinite(known[at]):
        return
    edge = INK if symbol.endswith("open") else "white"
    style = {"symbol": symbol, "size": 12, "color": INK, "line": {"color": edge, "width": 1.5}}
    name = f"lowest {where}: {h[at]:.4f} m".replace("-", "−")
    figure.add_trace(go.Scatter(x=[float(t[at])], y=[float(h[at])], mode="markers", name=name, marker=style))


def value_range(flight: Flight, shown: list[tuple[Floats, Floats]]) -> list[float]:
    """Range of the values within the time axis' first range, zero included, with some air."""
    low_s, high_s = shown_range(flight)
    inside = np.concatenate(
        [h[(t >= low_s) & (t <= high_s) & np.isfinite(h)] for t, h in shown] + [np.zeros(1)]
    )
    low, high = float(inside.min()), float(inside.max())
    air = 0.06 * max(high - low, 0.02)
    return [low - air, high + air]


def velocities(flight: Flight) -> go.Figure | None:
    """Nominal, filtered and sent velocity of each axis with the admissible box."""
    steps = flight.steps
    if steps is None or not np.isfinite(steps.nominal_enu_m_s).any():
        return None
    zero = zero_s(flight)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.045)
    t = steps.t_s - zero
    sent = np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)
    for axis in range(3):
        row, legend = axis + 1, axis == 0
        shown = [(t, v[:, axis]) for v in (steps.nominal_enu_m_s, steps.filtered_enu_m_s, sent)]
        style = (("nominal u'", NOMINAL, "dash", 1.6), ("filtered u*", FILTERED, "solid", 2.4),
                 ("sent, after slew limit and gate", COMMAND, "dot", 2.0))  # fmt: skip
        for (_, values), (name, color, dash, width) in zip(shown, style, strict=True):
            trace = line(t, values, name, color, dash=dash, width=width, legendgroup=name, showlegend=legend)
            figure.add_trace(trace, row=row, col=1)
        if flight.truth is not None:
            true = flight.truth.velocity_enu_m_s[:, axis]
            trace = line(
                flight.truth.t_s - zero, true, "vehicle (true)", LIMIT, width=1.0, legendgroup="true",
                showlegend=legend, visible="legendonly",
            )  # fmt: skip
            figure.add_trace(trace, row=row, col=1)
        limit = None if flight.velocity_max_m_s is None else flight.velocity_max_m_s[axis]
        low, high = value_range(flight, shown)
        if limit is not None:
            low, high = min(low, -1.15 * limit), max(high, 1.15 * limit)
            _limits(figure, flight, limit, row, legend)
        floor = low - 0.03 * (high - low)
        figure.add_trace(_active(steps, t, floor, legend), row=row, col=1)
        figure.update_yaxes(
            title_text=f"{AXES[axis]} [m/s]", range=[floor - 0.02 * (high - low), high], row=row, col=1
        )
    layout(figure, 760)
    add_phases(figure, flight, rows=3)
    time_axis(figure, flight, rows=3)
    return figure


def _limits(figure: go.Figure, flight: Flight, limit_m_s: float, row: int, legend: bool) -> None:
    ends = np.array([-zero_s(flight), flight.duration_s - zero_s(flight)])
    for sign in (-1.0, 1.0):
        trace = line(
            ends, np.full(2, sign * limit_m_s), "admissible box", LIMIT, dash="dashdot", width=1.0,
            legendgroup="box", showlegend=legend and sign > 0.0, hoverinfo="skip",
        )  # fmt: skip
        figure.add_trace(trace, row=row, col=1)


def _active(steps: Steps, t: Floats, floor: float, legend: bool) -> go.Scatter:
    """A bar along the bottom while the barrier changes the command."""
    y = np.where(steps.barrier_active, floor, np.nan)
    return line(
        t, y, "barrier active", BOUNDARY, width=5, legendgroup="active", showlegend=legend, hoverinfo="skip"
    )
