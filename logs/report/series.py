"""Figures over time: the charts of a flight, and the distances of the pairs of a fleet."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from logs.curves import BOUNDARY, Chart, Curve
from logs.reader.flight_data import Flight, Floats
from logs.recorder.markers import PAIR_COLORS
from logs.report.style import (
    UNSAFE,
    Axis,
    axis_of,
    chart,
    light,
    line,
    low_envelope,
    thin,
    value_range,
    zero_s,
)
from logs.verdict.verdict import PairSeries

# ellipsoid norm at which the distance axis ends at the earliest, unless all values are smaller
_MEASURE_SHOWN = 6.0
PAIRS_SHOWN = len(PAIR_COLORS)  # number of drawn pairs: the nearest ones


def draw(what: Chart, flight: Flight) -> go.Figure | None:
    """Draw a chart of a flight; ``None`` if the log has no data for it."""
    axis, zero = axis_of(flight), zero_s(flight)
    traces, axes, named = [], [], set[str]()
    for number, row in enumerate(what.rows, 1):
        shown: list[tuple[Floats, Floats]] = []
        for curve in row.curves:
            found = curve.values(flight)
            if found is None or not np.isfinite(found[1]).any():
                continue
            t_s, values = found[0] - zero, found[1]
            if row.lowest:
                t_s, values = low_envelope(t_s, values)
            traces.append((number, _trace(curve, t_s, values, first=curve.key not in named)))
            named.add(curve.key)
            if not curve.hidden:
                shown.append((t_s, values))
        axes.append({"title_text": row.title, **(row.axis or {"range": value_range(axis, shown)})})
    return chart(axis, what.height_px, traces, *axes, spacing=0.05) if traces else None


def _trace(curve: Curve, t_s: Floats, values: Floats, *, first: bool) -> go.Scatter:
    look = {"legendgroup": curve.key, "showlegend": first, "visible": "legendonly" if curve.hidden else True}
    if not curve.symbol:
        return line(t_s, values, curve.name, curve.color, dash=curve.dash, width=curve.width, **look)
    at = np.flatnonzero(np.isfinite(values))
    at = at[thin(len(at))]
    marker = {"symbol": curve.symbol, "size": 8, "color": curve.color}
    x, y = light(t_s[at]), light(values[at])
    return go.Scatter(x=x, y=y, mode="markers", name=curve.name, marker=marker, **look)


def distances(pairs: Sequence[PairSeries], axis: Axis) -> go.Figure | None:
    """Draw the distance of the nearest pairs, as ellipsoid norm and in m; ``None`` without pairs."""
    if not pairs:
        return None
    traces = []
    for color, pair in zip(PAIR_COLORS, sorted(pairs, key=_nearest), strict=False):
        for row, values in ((1, pair.measure), (2, pair.distance_m)):
            for both, width, opacity in ((pair.flying, 2.2, 1.0), (~pair.flying, 1.2, 0.35)):
                t_s, shown = low_envelope(pair.t_s, np.where(both, values, np.nan))
                look = {"width": width, "opacity": opacity, "legendgroup": pair.name, "connectgaps": False}
                first = row == 1 and opacity == 1.0
                traces.append((row, line(t_s, shown, pair.name, color, showlegend=first, **look)))
    measures = np.concatenate([pair.measure for pair in pairs])
    top = min(max(_MEASURE_SHOWN, 2.0 * float(measures.min())), float(measures.max()))
    measure = {"title_text": "in the ellipsoid's measure [1]", "range": [0.0, 1.05 * top]}
    distance = {"title_text": "distance [m]", "rangemode": "tozero"}
    figure = chart(axis, 620, traces, measure, distance, spacing=0.06, hovermode="closest")
    figure.add_hrect(y0=0.0, y1=1.0, fillcolor=UNSAFE, line={"width": 0}, layer="below", row=1, col=1)
    figure.add_hline(1.0, line={"color": BOUNDARY, "width": 1.5}, row=1, col=1)
    return figure


def _nearest(pair: PairSeries) -> float:
    return float(pair.measure[pair.flying].min()) if pair.flying.any() else math.inf
