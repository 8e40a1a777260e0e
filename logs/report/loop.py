"""Figures of the machine: loop timing, period histograms, age of the data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from logs.reader.flight_data import Flight, Floats
from logs.report.links import POSITION, Stream
from logs.report.links import TARGET as TARGET_STREAM
from logs.report.style import (
    BOUNDARY,
    COMMAND,
    LIMIT,
    NOMINAL,
    TARGET,
    TRUE,
    add_line,
    layout,
    light,
    line,
    over_time,
    rows_of,
    thin,
    value_range,
    zero_s,
)

_BINS = 80
_EDGE_SHARE = 0.05  # of the median, left and right of a histogram
_LOG_FLOOR = -0.3  # a single count stands above the axis
_WALL_US = [m * 10**n for n in range(6) for m in (1, 2, 5)]  # labels of the axis of wall times
_INTERVAL_MAX_MS = 100.0  # longer pauses are counted in the last bar


def loop_timing(flight: Flight) -> go.Figure | None:
    timing = flight.timing
    if timing is None:
        return None
    t = timing.t_s - zero_s(flight)
    figure = rows_of(2, 0.07)
    add_line(figure, 1, t, timing.period_s * 1e3, "period", TRUE, width=1.2)
    missed = np.flatnonzero(np.diff(timing.overruns) > 0) + 1
    if len(missed):
        keep = missed[thin(len(missed))]
        style = {"symbol": "x", "size": 8, "color": BOUNDARY}
        marks = go.Scatter(
            x=light(t[keep]), y=light(timing.period_s[keep] * 1e3), mode="markers", name="overrun",
            marker=style,
        )  # fmt: skip
        figure.add_trace(marks, row=1, col=1)
    add_line(figure, 2, t, timing.exec_s * 1e6, "whole tick", COMMAND, width=1.4)
    solve_us = np.where(timing.solve_s > 0.0, timing.solve_s * 1e6, np.nan)  # 0: the program did not run
    add_line(figure, 2, t, solve_us, "quadratic program", NOMINAL, width=1.4)
    late_us = timing.lateness_s * 1e6
    add_line(figure, 2, t, late_us, "start after deadline", LIMIT, width=1.0, visible="legendonly")
    over_time(figure, flight, 480, rows=2)
    figure.update_yaxes(title_text="period [ms]", row=1, col=1)
    figure.update_yaxes(title_text="wall time [µs]", type="log", tickvals=_WALL_US, row=2, col=1)
    return figure


def histograms(flight: Flight, streams: Sequence[Stream]) -> go.Figure | None:
    """How often which period of the loop and which interval between messages; counts are logarithmic."""
    shown: list[tuple[str, str, Floats]] = []
    if flight.timing is not None:
        shown.append(("loop period [ms]", TRUE, flight.timing.period_s[2:] * 1e3))
    for stream, title, color in (
        (POSITION, "between vehicle positions [ms]", COMMAND),
        (TARGET_STREAM, "between target samples [ms]", TARGET),
    ):
        found = next((s for s in streams if s.name == stream), None)
        if found is not None and len(found.t_s) > 2:
            shown.append((title, color, np.minimum(np.diff(found.t_s) * 1e3, _INTERVAL_MAX_MS)))
    shown = [(title, color, values[np.isfinite(values)]) for title, color, values in shown]
    shown = [each for each in shown if len(each[2])]
    if not shown:
        return None
    figure = make_subplots(
        rows=len(shown), cols=1, vertical_spacing=0.5 / len(shown) if len(shown) > 1 else 0
    )
    for row, (title, color, values) in enumerate(shown, 1):
        edge_ms = _EDGE_SHARE * float(np.median(values))  # equal values still make a bar that can be seen
        low, high = float(values.min()) - edge_ms, float(values.max()) + edge_ms
        counts, edges = np.histogram(values, bins=_BINS, range=(low, high))
        bars = go.Bar(
            x=light((edges[:-1] + edges[1:]) / 2), y=counts, width=float(edges[1] - edges[0]),
            marker_color=color, showlegend=False, name=title,
        )  # fmt: skip
        figure.add_trace(bars, row=row, col=1)
        figure.update_xaxes(title_text=title, row=row, col=1)
        top = float(np.log10(1.6 * counts.max()))
        figure.update_yaxes(title_text="count", type="log", dtick=1, range=[_LOG_FLOOR, top], row=row, col=1)
    layout(figure, 120 + 170 * len(shown))
    figure.update_layout(margin={"t": 16, "b": 56}, bargap=0.0)
    return figure


def data_age(flight: Flight) -> go.Figure | None:
    """Age of the target state and of the own state at each tick, with the limits of the configuration."""
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
        keep = refused[thin(len(refused))]
        figure.add_trace(
            go.Scatter(
                x=light(t[keep]), y=np.zeros(len(keep), np.float32), mode="markers", name="sample refused",
                marker={"symbol": "x-thin", "size": 8, "line": {"color": BOUNDARY, "width": 1.5}},
            )
        )  # fmt: skip
    over_time(figure, flight, 380)
    figure.update_yaxes(title_text="age at the tick [ms]", range=[low, high])
    return figure
