"""Figures with several flights in them: two that are compared, or the members of a fleet."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import plotly.graph_objects as go

from logs.reader.flight_data import Fleet, Flight, Floats
from logs.report.derived import Side, estimate_errors
from logs.report.series import AXES
from logs.report.space import circle, marker, relative_tracks
from logs.report.style import (
    BOUNDARY,
    LIMIT,
    UNSAFE,
    add_line,
    axis_of,
    boundary_height_m,
    fleet_axis,
    layout,
    layout_3d,
    light,
    line,
    low_envelope,
    rows_of,
    thin,
    time_axis,
    value_range,
    zero_s,
)
from logs.verdict.types import VIOLATION_LIMIT_M
from logs.verdict.verdict import PairSeries, shift_s

# colours of Okabe and Ito (2008), dark ones first, and two of Tol; repeated from the ninth member on
_COLORS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99",
)  # fmt: skip
# colours of pairs: others of Tol's, so that a member's colour means the same in every figure
_PAIR_COLORS = ("#332288", "#AA4499", "#117733", "#999933", "#661100", "#6699CC", "#DDCC77", "#888888")
_DASHES = ("solid", "dash", "dot")  # line styles, if there are more pairs than colours
_MEASURE_SHOWN = 6.0  # minimum upper end of the axis, in the ellipsoid's measure
_LIMITS_SHOWN = 3  # maximum pairs for which the limit along their connecting line is drawn
_PAIRS_SHOWN = 8  # nearest pairs, shown at first; the others are hidden
_LISTED, _LISTED_PX = 8, 22  # names of pairs in a line of the legend; height of a line

Values = Callable[[Flight], tuple[Floats, Floats] | None]  # times and values of a flight


def best_h(flight: Flight) -> tuple[Floats, Floats] | None:
    if flight.truth is not None:
        return low_envelope(flight.truth.t_s, flight.truth.h_min_m)
    steps = flight.steps
    return None if steps is None else (steps.t_s, np.where(steps.both_valid, steps.h_m, np.nan))


def target_age_ms(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.steps is None else (flight.steps.t_s, flight.steps.target_age_s * 1e3)


def tick_us(flight: Flight) -> tuple[Floats, Floats] | None:
    return None if flight.timing is None else (flight.timing.t_s, flight.timing.exec_s * 1e6)


def h_error_mm(flight: Flight) -> tuple[Floats, Floats] | None:
    found = estimate_errors(flight)
    return None if found is None else (found.t_s, 1e3 * found.h_m)


def sent_m_s(flight: Flight) -> tuple[Floats, Floats] | None:
    steps = flight.steps
    if steps is None or not steps.setpoint_sent.any():
        return None
    return steps.t_s, np.where(steps.setpoint_sent[:, None], steps.command_enu_m_s, np.nan)


def flown_m_s(flight: Flight) -> tuple[Floats, Floats] | None:
    if flight.truth is not None:
        return flight.truth.t_s, flight.truth.velocity_enu_m_s
    steps = flight.steps
    return None if steps is None else (steps.t_s, steps.own_velocity_enu_m_s)


def series(sides: Sequence[Side], values: Values, title: str) -> go.Figure | None:
    """One line of each flight over the time since its landing began."""
    figure, ranges = go.Figure(), []
    for side, color in zip(sides, _COLORS, strict=False):
        found = values(side.flight)
        if found is None or not np.isfinite(found[1]).any():
            continue
        t, y = found[0] - zero_s(side.flight), np.where(np.isfinite(found[1]), found[1], np.nan)
        ranges.append(value_range(side.flight, [(t, y)]))
        figure.add_trace(line(t, y, side.name, color, width=1.6))
    if not ranges:
        return None
    layout(figure, 360)
    figure.update_yaxes(title_text=title, range=[min(r[0] for r in ranges), max(r[1] for r in ranges)])
    time_axis(figure, axis_of([side.flight for side in sides]))
    if values is best_h:
        _boundary(figure)
    return figure


def vectors(sides: Sequence[Side], values: Values) -> go.Figure | None:
    """Three components of a velocity, one line of each flight."""
    figure = rows_of(3, 0.045)
    for side, color in zip(sides, _COLORS, strict=False):
        found = values(side.flight)
        if found is None:
            continue
        for axis in range(3):
            add_line(
                figure, axis + 1, found[0] - zero_s(side.flight), found[1][:, axis], side.name, color,
                width=1.5, legendgroup=side.name, showlegend=axis == 0,
            )  # fmt: skip
    if not figure.data:
        return None
    layout(figure, 640)
    for axis in range(3):
        figure.update_yaxes(title_text=f"{AXES[axis]} [m/s]", row=axis + 1, col=1)
    time_axis(figure, axis_of([side.flight for side in sides]), rows=3)
    return figure


def altitudes(sides: Sequence[Side]) -> go.Figure | None:
    """e_z over d of each flight, with its boundary."""
    figure, far = go.Figure(), 0.6
    for side, color in zip(sides, _COLORS, strict=False):
        tracks = relative_tracks(side.flight)
        if not tracks:
            continue
        points = tracks[-1].points_m  # the best known comes last
        d = np.hypot(points[:, 0], points[:, 1])
        far = max(far, 1.1 * float(np.nanmax(d)))
        figure.add_trace(line(d, points[:, 2], f"{side.name}, {tracks[-1].name}", color, width=2))
    if not figure.data:
        return None
    for number, side in enumerate(sides):
        if side.flight.barrier is not None:
            d = np.linspace(0.0, far, 300)
            filled = {"fill": "tozeroy", "fillcolor": UNSAFE} if number == 0 else {"dash": "dash"}
            name = f"h = 0 of {side.name}"
            figure.add_trace(line(d, boundary_height_m(side.flight, d), name, LIMIT, width=1.4, **filled))
    layout(figure, 440)
    figure.update_xaxes(title_text="horizontal distance d [m]", range=[0.0, far])
    figure.update_yaxes(title_text="relative altitude e<sub>z</sub> [m]")
    return figure


def barriers(fleet: Fleet) -> go.Figure | None:
    """h of each member over its own pad since its landing began; ``None`` where no log has it."""
    figure, lowest, highest = go.Figure(), 0.0, 0.0
    for number, (member, flight) in enumerate(fleet.flights.items()):
        known = flight.truth if flight.truth is not None else flight.steps
        if known is None or not np.isfinite(known.h_m).any():
            continue
        since = known.t_s >= zero_s(flight)
        t_s, h_m = low_envelope(known.t_s[since] + shift_s(fleet, flight), known.h_m[since])
        figure.add_trace(line(t_s, h_m, member, _COLORS[number % len(_COLORS)]))
        if np.isfinite(h_m).any():
            lowest, highest = min(lowest, float(np.nanmin(h_m))), max(highest, float(np.nanmax(h_m)))
    if not figure.data:
        return None
    layout(figure, 360)
    time_axis(figure, fleet_axis(fleet), hovermode="closest")
    air_m = 0.06 * max(highest - lowest, 0.02)
    figure.update_yaxes(title_text="h [m]", range=[lowest - air_m, highest + air_m])
    _boundary(figure)
    return figure


def _boundary(figure: go.Figure) -> None:
    """Shade h < 0 and mark the limit of a violation."""
    figure.add_hrect(y0=-100.0, y1=0.0, fillcolor=UNSAFE, line={"width": 0}, layer="below")
    figure.add_hline(VIOLATION_LIMIT_M, line={"color": BOUNDARY, "width": 1, "dash": "dot"})


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
    for number, (member, flight) in enumerate(fleet.flights.items()):
        color = _COLORS[number % len(_COLORS)]
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
            x, y, z = light(_ends(points_m)).T
            marks = {"symbol": ["circle", "square"], "size": 4, "color": color}
            figure.add_trace(
                go.Scatter3d(
                    x=x, y=y, z=z, mode="markers", marker=marks, name=member, legendgroup=member,
                    showlegend=False, hovertext=["start", "end"],
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
    for number, (member, flight) in enumerate(fleet.flights.items()):
        color = _COLORS[number % len(_COLORS)]
        for name, dash, points_m in _paths(flight):
            width = 1.4 if name else 2.4
            x, y = points_m[:, 0], points_m[:, 1]
            figure.add_trace(line(x, y, f"{member}{name}", color, dash=dash, width=width, legendgroup=member))
            ends = _ends(points_m)
            if name and len(ends):
                circle(figure, ends[-1], flight.pad_radius_m, color)
            for end, what, symbol in zip(ends, ("start", "end"), ("circle", "square"), strict=False):
                if not name:
                    more = {"showlegend": False, "legendgroup": member, "hovertext": [what]}
                    marker(figure, end[0], end[1], member, symbol, color, **more)
    layout(figure, 560)
    figure.update_xaxes(title_text="east x [m]", constrain="domain")
    figure.update_yaxes(title_text="north y [m]", scaleanchor="x", scaleratio=1)
    return figure


def distances(fleet: Fleet, pairs: Sequence[PairSeries]) -> go.Figure | None:
    """Distance of each pair over time, in the ellipsoid's measure and in metres; ``None`` without a pair.

    Of many pairs those that came nearest are shown at first.
    """
    if not pairs:
        return None
    figure, many = rows_of(2, 0.06), len(pairs) > _LIMITS_SHOWN
    nearest = {pair.name for pair in sorted(pairs, key=_nearest)[:_PAIRS_SHOWN]}
    for number, pair in enumerate(pairs):
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
    more_px = _LISTED_PX * ((len(pairs) - 1) // _LISTED)
    layout(figure, 620 + more_px, more_px)
    time_axis(figure, fleet_axis(fleet), rows=2, hovermode="closest")
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
