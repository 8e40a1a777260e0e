"""Figures of a fleet: lanes and paths of all members, distances of pairs, barriers over the pads."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from flightstack.core.types import Intent
from logs.reader.fleet_words import Words
from logs.reader.flight_data import Fleet, Flight, Floats, phase_name
from logs.report.style import (
    BOUNDARY,
    FAULT,
    INK,
    LIMIT,
    NOMINAL,
    PHASE_SOLID,
    UNSAFE,
    add_line,
    layout,
    layout_3d,
    light,
    line,
    low_envelope,
    rows_of,
    thin,
    words,
)
from logs.report.timeline import bar
from logs.schema.events import Severity
from logs.verdict.pairs import PairSeries, shift_s
from logs.verdict.types import VIOLATION_LIMIT_M

# Okabe and Ito (2008), dark ones first, and two of Tol; from the ninth member on they come again
_COLORS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99",
)  # fmt: skip
# of pairs: others of Tol's, so that the colour of a member means the same in every figure
_PAIR_COLORS = ("#332288", "#AA4499", "#117733", "#999933", "#661100", "#6699CC", "#DDCC77", "#888888")
_INTENT_COLORS = {
    Intent.STANDING: "#d5d9de",
    Intent.WAITING: "#f5e3b3",
    Intent.LANDING: "#b5dcf3",
    Intent.COMMITTED: "#9ad6c3",
    Intent.CLEARING: "#efb08a",
    Intent.DOWN: "#e4e7eb",
}
_DASHES = ("solid", "dash", "dot")  # of pairs, when there are more than colours
_WAITS = NOMINAL
_ROW_PX = 24
_LETTER_SHARE = 0.009  # of the axis, for a letter of a name; a bar that is too short carries none
_MEASURE_SHOWN = 6.0  # of the ellipsoid's measure at least; what is farther away is of no interest
_LIMITS_SHOWN = 3  # pairs; of more the limit along the line between two is not drawn
_PAIRS_SHOWN = 8  # that came nearest; the others are hidden at first
_LISTED, _LISTED_PX = 8, 22  # names of pairs in a line of the legend; height of a line
_LANES_MAX = 16  # of silent ways; more are not read
_EVENTS_MAX = 500


def color_of(fleet: Fleet, member: str) -> str:
    return _COLORS[list(fleet.flights).index(member) % len(_COLORS)]


def end_s(fleet: Fleet) -> float:
    """Length of the log, from the origin of the fleet to the end of the last flight."""
    return max(flight.duration_s + shift_s(fleet, flight) for flight in fleet.flights.values())


def _time_axis(figure: go.Figure, fleet: Fleet, rows: int = 1) -> None:
    """Count from the origin of the fleet; the page moves all figures with this mark together."""
    whole = [0.0, end_s(fleet)]
    figure.update_layout(meta={"time": True, "rows": rows, "landing": _landings(fleet), "whole": whole})
    figure.update_xaxes(range=whole)
    at = {"row": rows, "col": 1} if rows > 1 else {}
    figure.update_xaxes(title_text="time since the log began [s]", **at)


def _landings(fleet: Fleet) -> list[float]:
    """From the first begin of a landing to the end."""
    begins = [
        f.landing_start_s + shift_s(fleet, f) for f in fleet.flights.values() if f.landing_start_s is not None
    ]
    return [max(0.0, min(begins, default=0.0) - 1.0), end_s(fleet)]


def lanes(fleet: Fleet, words: Words) -> go.Figure:
    """Phases of all members, what each was about to do and to whom it gave way, silent ways, events."""
    figure, names, whole_s = go.Figure(), [], end_s(fleet)

    def labelled(ends: list[float], lane: str, color: str, text: str, label: str) -> None:
        bar(figure, ends, lane, color, text)
        if ends[1] - ends[0] > _LETTER_SHARE * len(label) * whole_s:
            figure.add_annotation(
                x=sum(ends) / 2, y=lane, text=label, showarrow=False, font={"size": 10, "color": INK}
            )

    for member, flight in fleet.flights.items():
        add_s = shift_s(fleet, flight)
        names += [f"{member} phase", f"{member} right of way"]
        for phase, begin_s, until_s in flight.phase_spans():
            name = phase_name(phase)
            color = PHASE_SOLID.get(phase, LIMIT)
            labelled([begin_s + add_s, until_s + add_s], names[-2], color, f"{member}: {name}", name)
        for span in words.spans[member]:
            name, others = span.intent.name.lower(), ", ".join(span.gives_way_to)
            color = _WAITS if span.waits else _INTENT_COLORS[span.intent]
            text = f"{member}: {name}" + (f", gives way to {others}" if others else "")
            label = f"waits for {others}" if span.waits else name
            labelled([span.begin_s, span.end_s], names[-1], color, text, label)
    for way in [way for way in words.ways if way.silent][:_LANES_MAX]:
        names.append(f"{way.hearer} hears no {way.teller}")
        for begin_s, until_s in way.silent:
            bar(figure, [begin_s, until_s], names[-1], FAULT, f"{way.hearer} hears nothing of {way.teller}")
    if fleet.events:
        names.append("event")
        _events(figure, fleet)
    layout(figure, 116 + _ROW_PX * len(names))
    _time_axis(figure, fleet)
    figure.update_layout(hovermode="closest", showlegend=False, margin={"t": 32, "b": 50, "l": 150})
    figure.update_yaxes(categoryorder="array", categoryarray=names[::-1], showgrid=True, automargin=True)
    return figure


def _events(figure: go.Figure, fleet: Fleet) -> None:
    shown = fleet.events[:_EVENTS_MAX]
    colors = [
        BOUNDARY if e.level >= Severity.ERROR else NOMINAL if e.level >= Severity.WARN else LIMIT
        for e in shown
    ]
    figure.add_trace(
        go.Scatter(
            x=[e.t_s for e in shown], y=["event"] * len(shown), mode="markers", name="event",
            text=[words(f"{e.source}: {e.text}") for e in shown],
            marker={"symbol": "line-ns", "size": 14, "line": {"color": colors, "width": 2}},
            hovertemplate="%{x:.2f} s<br>%{text}<extra></extra>",
        )
    )  # fmt: skip


def _paths(flight: Flight) -> list[tuple[str, str, Floats]]:
    """Name, dash and positions (n, 3) of vehicle and pad: true ones, else estimated."""
    truth, steps = flight.truth, flight.steps
    if truth is not None:
        return [("", "solid", truth.position_enu_m), (" pad", "dot", truth.pad_position_enu_m)]
    if steps is None:
        return []
    own = np.where(steps.own_valid[:, None], steps.own_position_enu_m, np.nan)
    target = np.where(steps.target_valid[:, None], steps.target_position_enu_m, np.nan)
    return [("", "dash", own), (" pad", "dot", target)]


def _ends(points_m: Floats) -> Floats:
    """First and last known position, (2, 3); empty without any."""
    known = points_m[np.isfinite(points_m).all(1)]
    return known[[0, -1]] if len(known) else known


def room_3d(fleet: Fleet) -> go.Figure:
    """All paths in the room, with heights and distances to the same scale."""
    figure = go.Figure()
    for member, flight in fleet.flights.items():
        color = color_of(fleet, member)
        for name, dash, points_m in _paths(flight):
            x, y, z = light(points_m[thin(len(points_m))]).T
            style = {"color": color, "width": 4 if name else 6, "dash": dash}
            figure.add_trace(
                go.Scatter3d(
                    x=x, y=y, z=z, mode="lines", line=style, name=f"{member}{name}", legendgroup=member
                )
            )
            if name:
                continue
            ends = light(_ends(points_m))
            marks = {"symbol": ["circle", "square"], "size": 4, "color": color}
            figure.add_trace(
                go.Scatter3d(
                    x=ends[:, 0], y=ends[:, 1], z=ends[:, 2], mode="markers", marker=marks, name=member,
                    legendgroup=member, showlegend=False, hovertext=["start", "end"],
                )
            )  # fmt: skip
    return layout_3d(
        figure,
        ("x, east [m]", "y, north [m]", "z, up [m]"),
        zaxis={"rangemode": "tozero"},
        aspectmode="data",
        camera={"eye": {"x": 0.9, "y": -1.5, "z": 0.9}, "center": {"x": 0.0, "y": 0.0, "z": -0.15}},
    )


def plan(fleet: Fleet) -> go.Figure:
    """All paths from above: circles at the start, squares at the end, the pads at the end of the log."""
    figure = go.Figure()
    for member, flight in fleet.flights.items():
        color = color_of(fleet, member)
        for name, dash, points_m in _paths(flight):
            width = 1.4 if name else 2.4
            x, y = points_m[:, 0], points_m[:, 1]
            trace = line(x, y, f"{member}{name}", color, dash=dash, width=width, legendgroup=member)
            figure.add_trace(trace)
            ends = _ends(points_m)
            if not len(ends):
                continue
            if name:
                (px, py), r = ends[-1, :2], flight.pad_radius_m
                figure.add_shape(
                    type="circle",
                    x0=px - r,
                    x1=px + r,
                    y0=py - r,
                    y1=py + r,
                    line={"color": color, "width": 1.2},
                )
                continue
            marks = {"symbol": ["circle", "square"], "size": 10, "color": color,
                     "line": {"color": "white", "width": 1.5}}  # fmt: skip
            figure.add_trace(
                go.Scatter(
                    x=ends[:, 0], y=ends[:, 1], mode="markers", marker=marks, name=member,
                    legendgroup=member, showlegend=False, hovertext=["start", "end"],
                )
            )  # fmt: skip
    layout(figure, 560)
    figure.update_xaxes(title_text="east x [m]", constrain="domain")
    figure.update_yaxes(title_text="north y [m]", scaleanchor="x", scaleratio=1)
    return figure


def distances(fleet: Fleet, series: Sequence[PairSeries]) -> go.Figure | None:
    """Distance of each pair over time, in the ellipsoid's measure and in metres; ``None`` without a pair.

    Of many pairs those that came nearest are shown at first.
    """
    if not series:
        return None
    figure, many = rows_of(2, 0.06), len(series) > _LIMITS_SHOWN
    nearest = {pair.name for pair in sorted(series, key=_nearest)[:_PAIRS_SHOWN]}
    for number, pair in enumerate(series):
        color, dash = _PAIR_COLORS[number % len(_PAIR_COLORS)], _DASHES[number // len(_PAIR_COLORS) % 3]
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
    more_px = _LISTED_PX * ((len(series) - 1) // _LISTED)
    layout(figure, 620 + more_px, more_px)
    _time_axis(figure, fleet, rows=2)
    top = min(
        max(_MEASURE_SHOWN, 2.0 * min(float(p.measure.min()) for p in series)),
        max(float(p.measure.max()) for p in series),
    )
    figure.update_yaxes(title_text="in the ellipsoid's measure [1]", range=[0.0, 1.05 * top], row=1, col=1)
    figure.update_yaxes(title_text="distance [m]", rangemode="tozero", row=2, col=1)
    figure.add_hrect(y0=0.0, y1=1.0, fillcolor=UNSAFE, line={"width": 0}, layer="below", row=1, col=1)
    figure.add_hline(1.0, line={"color": BOUNDARY, "width": 1.5}, row=1, col=1)
    return figure


def _nearest(pair: PairSeries) -> float:
    return float(pair.measure[pair.flying].min()) if pair.flying.any() else math.inf


def barriers(fleet: Fleet) -> go.Figure | None:
    """h of each member over its own pad; ``None`` where no log knows it."""
    figure, lowest, highest = go.Figure(), 0.0, 0.0
    for member, flight in fleet.flights.items():
        known = flight.truth if flight.truth is not None else flight.steps
        if known is None or not np.isfinite(known.h_m).any():
            continue
        t_s = known.t_s + shift_s(fleet, flight)
        since = t_s >= (flight.landing_start_s or 0.0) + shift_s(fleet, flight)
        t_s, h_m = low_envelope(t_s[since], known.h_m[since])
        figure.add_trace(line(t_s, h_m, member, color_of(fleet, member)))
        if np.isfinite(h_m).any():
            lowest, highest = min(lowest, float(np.nanmin(h_m))), max(highest, float(np.nanmax(h_m)))
    if not figure.data:
        return None
    layout(figure, 360)
    _time_axis(figure, fleet)
    air_m = 0.06 * max(highest - lowest, 0.02)
    figure.add_hrect(y0=lowest - 10.0, y1=0.0, fillcolor=UNSAFE, line={"width": 0}, layer="below")
    figure.add_hline(VIOLATION_LIMIT_M, line={"color": LIMIT, "width": 1, "dash": "dot"})
    figure.update_yaxes(title_text="h [m]", range=[lowest - air_m, highest + air_m])
    return figure
