"""Figures of several flights over time: two compared flights, or the members of a fleet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import plotly.graph_objects as go

from logs.derive.markers import COLORS, PAIR_COLORS
from logs.reader.flight_data import Flight, Floats
from logs.report.derived import Side, estimate_errors
from logs.report.series import AXES, sent_m_s
from logs.report.style import (
    BOUNDARY,
    UNSAFE,
    Axis,
    add_line,
    layout,
    line,
    low_envelope,
    rows_of,
    time_axis,
    value_range,
)
from logs.verdict.types import VIOLATION_LIMIT_M
from logs.verdict.verdict import PairSeries

_DASHES = ("solid", "dash", "dot")  # line styles, if there are more pairs than colours
_MEASURE_SHOWN = 6.0  # minimum upper end of the axis, in the ellipsoid's measure
_LIMITS_SHOWN = 3  # greatest number of pairs whose limit along their connecting line is drawn
_PAIRS_SHOWN = 8  # number of nearest pairs that are visible at first; the others are hidden
_LISTED, _LISTED_PX = 8, 22  # pair names per line of the legend; height of a line

Values = Callable[[Flight], tuple[Floats, Floats] | None]  # times and values of a flight


def best_h(flight: Flight) -> tuple[Floats, Floats] | None:
    """Return true h, else the controller's h, since the landing began."""
    truth, steps, start_s = flight.truth, flight.steps, flight.landing_start_s or 0.0
    if truth is not None:
        t_s, h_m = truth.t_s, truth.h_min_m
    elif steps is not None:
        t_s, h_m = steps.t_s, np.where(steps.both_valid, steps.h_m, np.nan)
    else:
        return None
    return low_envelope(t_s[t_s >= start_s], h_m[t_s >= start_s])


def target_age_ms(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.steps is None else (flight.steps.t_s, flight.steps.target_age_s * 1e3)


def tick_us(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.timing is None else (flight.timing.t_s, flight.timing.exec_s * 1e6)


def h_error_mm(flight: Flight) -> tuple[Floats, Floats] | None:
    found = estimate_errors(flight)
    return None if found is None else (found.t_s, 1e3 * found.h_m)


def velocity_sent(flight: Flight) -> tuple[Floats, Floats] | None:
    steps = flight.steps
    return None if steps is None or not steps.setpoint_sent.any() else (steps.t_s, sent_m_s(steps))


def velocity_flown(flight: Flight) -> tuple[Floats, Floats] | None:
    if flight.truth is not None:
        return flight.truth.t_s, flight.truth.velocity_enu_m_s
    return None if flight.steps is None else (flight.steps.t_s, flight.steps.own_velocity_enu_m_s)


def series(
    sides: Sequence[Side], axis: Axis, values: Values, title: str, hovermode: str = "x unified"
) -> go.Figure | None:
    """Draw one line per flight over time; a figure of h also has the boundary and the violation limit."""
    figure, shown = go.Figure(), []
    for number, side in enumerate(sides):
        found = values(side.flight)
        if found is None or not np.isfinite(found[1]).any():
            continue
        t, y = found[0] + side.offset_s, np.where(np.isfinite(found[1]), found[1], np.nan)
        shown.append((t, y))
        figure.add_trace(line(t, y, side.name, COLORS[number % len(COLORS)], width=1.6))
    if not shown:
        return None
    layout(figure, 360)
    figure.update_yaxes(title_text=title, range=value_range(axis, shown))
    time_axis(figure, axis, hovermode=hovermode)
    if values is best_h:
        figure.add_hrect(y0=-100.0, y1=0.0, fillcolor=UNSAFE, line={"width": 0}, layer="below")
        figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})
    return figure


def vectors(sides: Sequence[Side], axis: Axis, values: Values) -> go.Figure | None:
    """Draw three components of a velocity, one line per flight."""
    figure = rows_of(3, 0.045)
    for number, side in enumerate(sides):
        found = values(side.flight)
        if found is None:
            continue
        for row in (1, 2, 3):
            add_line(
                figure, row, found[0] + side.offset_s, found[1][:, row - 1], side.name,
                COLORS[number % len(COLORS)], width=1.5, legendgroup=side.name, showlegend=row == 1,
            )  # fmt: skip
    if not figure.data:
        return None
    layout(figure, 640)
    for row, name in enumerate(AXES, 1):
        figure.update_yaxes(title_text=f"{name} [m/s]", row=row, col=1)
    time_axis(figure, axis, rows=3)
    return figure


def distances(pairs: Sequence[PairSeries], axis: Axis) -> go.Figure | None:
    """Draw the distance of each pair over time, in the ellipsoid's measure and in m; ``None`` without pairs.

    Of many pairs only the nearest are visible at first.
    """
    if not pairs:
        return None
    figure, many = rows_of(2, 0.06), len(pairs) > _LIMITS_SHOWN
    nearest = {pair.name for pair in sorted(pairs, key=_nearest)[:_PAIRS_SHOWN]}
    for number, pair in enumerate(pairs):
        color, dash = PAIR_COLORS[number % len(PAIR_COLORS)], _DASHES[number // len(PAIR_COLORS) % 3]
        for row, values in ((1, pair.measure), (2, pair.distance_m)):
            for both, width, opacity in ((pair.flying, 2.2, 1.0), (~pair.flying, 1.2, 0.35)):
                t_s, shown = low_envelope(pair.t_s, np.where(both, values, np.nan))
                listed = row == 1 and opacity == 1.0
                seen = True if pair.name in nearest else "legendonly"
                add_line(
                    figure, row, t_s, shown, pair.name, color, width=width, dash=dash, opacity=opacity,
                    showlegend=listed, legendgroup=pair.name, connectgaps=False, visible=seen,
                )  # fmt: skip
        if many:
            continue
        limit_m = pair.distance_m / np.maximum(pair.measure, 1e-9)
        add_line(
            figure, 2, pair.t_s, np.where(pair.flying, limit_m, np.nan), f"limit of {pair.name}", color,
            dash="dot", width=1.2,
        )  # fmt: skip
    more_px = _LISTED_PX * ((len(pairs) - 1) // _LISTED)
    layout(figure, 620 + more_px, more_px)
    time_axis(figure, axis, rows=2, hovermode="closest")
    top = min(
        max(_MEASURE_SHOWN, 2.0 * min(float(p.measure.min()) for p in pairs)),
        max(float(p.measure.max()) for p in pairs),
    )
    figure.update_yaxes(title_text="in the ellipsoid's measure [1]", range=[0.0, 1.05 * top], row=1, col=1)
    figure.update_yaxes(title_text="distance [m]", rangemode="tozero", row=2, col=1)
    figure.add_hrect(y0=0.0, y1=1.0, fillcolor=UNSAFE, line={"width": 0}, layer="below", row=1, col=1)
    figure.add_hline(1.0, line={"color": BOUNDARY, "width": 1.5}, row=1, col=1)
    return figure


def _nearest(pair: PairSeries) -> float:
    return float(pair.measure[pair.flying].min()) if pair.flying.any() else math.inf
