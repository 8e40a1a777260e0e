"""Figures of the members of a fleet over time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from logs.reader.flight_data import Flight, Floats
from logs.recorder.markers import COLORS, PAIR_COLORS
from logs.report.derived import Side
from logs.report.style import (
    BOUNDARY,
    UNSAFE,
    Axis,
    chart,
    line,
    low_envelope,
    value_range,
)
from logs.verdict.types import VIOLATION_LIMIT_M
from logs.verdict.verdict import PairSeries

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
