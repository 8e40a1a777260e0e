"""Spatial figures: the landing relative to the pad (paper Fig. 7, 8, 10, 11), and paths in the world (12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.barrier import Barrier
from logs.curves import BOUNDARY, ESTIMATED, INK, LIMIT, TARGET, TRUE
from logs.reader.flight_data import Flight, Floats
from logs.recorder.markers import COLORS
from logs.report.derived import Side, touch_index
from logs.report.style import UNSAFE, layout, layout_3d, light, line, thin

_SURFACE_RINGS, _SURFACE_SPOKES = 48, 73
_SURFACE_COLORS = [[0.0, "#fff3c4"], [0.5, "#f7b267"], [1.0, "#d55e00"]]  # low to high, as in the paper
_DISTANCE_MIN_M = 0.6  # minimum range of distances, m, before a margin of 10 %, so that the cone is visible
_BEFORE = "#9aa5b1"
_SYMBOLS_3D = {"circle": "circle", "square-open": "square", "triangle-up": "diamond"}


class Track(NamedTuple):
    """Positions of vehicle and landing spot from one source, m, (n, 3); NaN where unknown."""

    source: str  # "true" or "estimate"
    color: str
    dash: str
    t_s: Floats
    vehicle_m: Floats
    target_m: Floats

    @property
    def relative_m(self) -> Floats:
        return self.vehicle_m - self.target_m


def tracks(flight: Flight) -> list[Track]:
    """Return the tracks of a log, the most accurate track first."""
    steps, truth, found = flight.steps, flight.truth, []
    if truth is not None:
        found.append(Track("true", TRUE, "solid", truth.t_s, truth.position_enu_m, truth.pad_position_enu_m))
    if steps is not None:
        own = np.where(steps.own_valid[:, None], steps.own_position_enu_m, np.nan)
        target = np.where(steps.target_valid[:, None], steps.target_position_enu_m, np.nan)
        found.append(Track("estimate", ESTIMATED, "dash" if found else "solid", steps.t_s, own, target))
    return [track for track in found if np.isfinite(track.vehicle_m).all(1).any()]


def _relative(flight: Flight) -> list[tuple[Track, Floats]]:
    """Return the tracks with known relative positions since the landing's start; positions in m, (n, 3)."""
    start_s = flight.landing_start_s or 0.0
    found = [(track, track.relative_m[track.t_s >= start_s]) for track in tracks(flight)]
    return [(track, e_m) for track, e_m in found if len(_known(e_m))]


def _known(points_m: Floats) -> Floats:
    return points_m[np.isfinite(points_m).all(1)]


def _distance_max_m(paths: Sequence[Floats]) -> float:
    return 1.1 * max(_DISTANCE_MIN_M, *(float(np.nanmax(np.hypot(e_m[:, 0], e_m[:, 1]))) for e_m in paths))


def trajectory_3d(flights: Mapping[str, Flight]) -> go.Figure | None:
    """Draw the relative trajectories over the boundary h = 0; ``flights``: by name of the vehicle."""
    found = {name: paths for name, flight in flights.items() if (paths := _relative(flight))}
    if not found:
        return None
    figure, far_m = go.Figure(), _distance_max_m([e_m for paths in found.values() for _, e_m in paths])
    for barrier in dict.fromkeys(flights[name].barrier for name in found):
        if barrier is not None:
            figure.add_trace(_surface(barrier, far_m))
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    for radius_m in dict.fromkeys(flights[name].pad_radius_m for name in found):
        rim_m = radius_m * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(61)))
        _line_3d(figure, rim_m, "rim of the pad", TARGET, 6)
    colors, named = dict(zip(flights, cycle(COLORS), strict=False)), set[str]()
    for name, paths in found.items():
        for track, e_m in reversed(paths):
            width, of = 7 if track.dash == "solid" else 4, f"{name} ({track.source})"
            _line_3d(figure, e_m, of, colors[name], width, track.dash, legendgroup=name)
    for name, paths in found.items():
        for what, at_m, symbol in _places(flights[name], paths[0][1]):
            # a click in the legend hides the markers of all vehicles, but no path
            more = {"showlegend": what not in named, "legendgroup": f"markers: {what}", "hovertext": name}
            _marker(figure, at_m, what, _SYMBOLS_3D[symbol], INK, **more)
            named.add(what)
    # the camera is beside the first approach, so that the path is in front of the surface
    x_m, y_m, _ = _known(next(iter(found.values()))[0][1])[0]
    bearing = float(np.arctan2(y_m, x_m)) - 0.9
    eye = {"x": 1.8 * float(np.cos(bearing)), "y": 1.8 * float(np.sin(bearing)), "z": 0.9}
    return layout_3d(
        figure,
        ("e<sub>x</sub>, east [m]", "e<sub>y</sub>, north [m]", "e<sub>z</sub>, up [m]"),
        aspectmode="manual",  # heights have a larger scale than distances, as in the paper's figures
        aspectratio={"x": 1.3, "y": 1.3, "z": 0.75},
        camera={"eye": eye, "center": {"x": 0.0, "y": 0.0, "z": -0.2}},
    )


def _surface(barrier: Barrier, distance_max_m: float) -> go.Surface:
    # rings are closer together near the apex, where the boundary bends
    d = distance_max_m * np.linspace(0.0, 1.0, _SURFACE_RINGS) ** 1.4
    angle = np.linspace(0.0, 2.0 * np.pi, _SURFACE_SPOKES)
    height = np.repeat(np.vectorize(barrier.height)(d)[:, None], len(angle), axis=1)
    step = float(height.max()) / 6.0
    contour = {"show": True, "color": "rgba(110, 50, 0, 0.45)", "start": step, "end": 6 * step, "size": step}
    return go.Surface(
        x=light(np.outer(d, np.cos(angle))), y=light(np.outer(d, np.sin(angle))), z=light(height),
        colorscale=_SURFACE_COLORS, showscale=False, opacity=0.55, name="h = 0", showlegend=True,
        contours={"z": contour}, hoverinfo="skip",
    )  # fmt: skip


def altitude_over_distance(flight: Flight) -> go.Figure | None:
    """Draw relative altitude over horizontal distance, with the boundary h = 0."""
    found = _relative(flight)
    if not found:
        return None
    paths = [e_m for _, e_m in found]
    figure, far = go.Figure(), _distance_max_m(paths)
    heights = np.concatenate(paths)[:, 2]
    bottom, top = min(-0.05, float(np.nanmin(heights)) - 0.03), float(np.nanmax(heights))
    if flight.barrier is not None:
        d = np.linspace(0.0, far, 300)
        b = np.vectorize(flight.barrier.height)(d)
        top, floor = max(top, float(b.max())), np.full_like(d, bottom - 1.0)
        figure.add_trace(line(d, floor, "", "rgba(0,0,0,0)", showlegend=False, hoverinfo="skip"))
        name = "boundary h = 0, unsafe below"
        figure.add_trace(line(d, b, name, BOUNDARY, width=2.2, fill="tonexty", fillcolor=UNSAFE))
    for track, e_m in reversed(found):
        look = {"dash": track.dash, "width": 2.4 if track.dash == "solid" else 1.6}
        d = np.hypot(e_m[:, 0], e_m[:, 1])
        figure.add_trace(line(d, e_m[:, 2], f"vehicle ({track.source})", track.color, **look))
    for name, e_m, symbol in _places(flight, paths[0]):
        _marker(figure, np.array([np.hypot(e_m[0], e_m[1]), e_m[2]]), name, symbol, INK)
    figure.add_vline(
        flight.pad_radius_m, line={"color": LIMIT, "width": 1, "dash": "dot"},
        annotation={"text": "pad radius", "font": {"size": 12, "color": LIMIT}, "yanchor": "top"},
    )  # fmt: skip
    layout(figure, 460)
    figure.update_xaxes(title_text="horizontal distance d [m]", range=[0.0, far])
    figure.update_yaxes(title_text="relative altitude e<sub>z</sub> [m]", range=[bottom, top * 1.08])
    return figure


def _places(flight: Flight, path_m: Floats) -> list[tuple[str, Floats, str]]:
    """Return name, position and symbol of start, first contact and end of a path with a known position."""
    known, touch = _known(path_m), touch_index(flight)
    found = [("start", known[0], "circle"), ("end", known[-1], "square-open")]
    if touch is not None and flight.truth is not None:
        found.append(("touchdown", flight.truth.e_m[touch], "triangle-up"))
    return found


def plan(flight: Flight) -> go.Figure | None:
    """Draw from above the paths since the start of the landing, and the vehicle's path before that time."""
    found, figure = tracks(flight), go.Figure()
    if not found:
        return None
    for track in found:
        best = track is found[0]
        since = track.t_s >= (flight.landing_start_s or 0.0)
        if best and not since.all():
            x, y, _ = track.vehicle_m[~since].T
            figure.add_trace(line(x, y, "before the landing", _BEFORE, dash="dot", width=1.2))
        look = {"width": 2.2 if best else 1.5, "dash": "solid" if best else "dash"}
        vehicle_m, target_m = track.vehicle_m[since], track.target_m[since]
        for body, points_m, color in (("vehicle", vehicle_m, track.color), ("target", target_m, TARGET)):
            known = _known(points_m)
            if len(known):
                x, y, _ = points_m.T
                figure.add_trace(line(x, y, f"{body} ({track.source})", color, **look))
            if best and len(known) and body == "target":
                (x, y, _), r = known[-1], flight.pad_radius_m
                edge = {"color": color, "width": 1.2}
                figure.add_shape(type="circle", x0=x - r, x1=x + r, y0=y - r, y1=y + r, line=edge)
            elif best and len(known):
                for at_m, what, symbol in ((known[0], "start", "circle"), (known[-1], "end", "square")):
                    _marker(figure, at_m[:2], what, symbol, color, showlegend=False)
    touch = touch_index(flight)
    if touch is not None and flight.truth is not None:
        _marker(figure, flight.truth.position_enu_m[touch, :2], "touchdown", "triangle-up", INK)
    layout(figure, 540)
    figure.update_xaxes(title_text="east x [m]", constrain="domain")
    figure.update_yaxes(title_text="north y [m]", scaleanchor="x", scaleratio=1)
    return figure


def room_3d(sides: Sequence[Side]) -> go.Figure | None:
    """Draw all paths in 3-D, with heights and distances at the same scale; ``None``: no known positions."""
    figure = go.Figure()
    for number, side in enumerate(sides):
        color, group = COLORS[number % len(COLORS)], {"legendgroup": side.name}
        for track in tracks(side.flight)[:1]:
            _line_3d(figure, track.vehicle_m, side.name, color, 6, track.dash, **group)
            _line_3d(figure, track.target_m, f"{side.name} pad", color, 4, "dot", **group)
            known = _known(track.vehicle_m)
            for at_m, what, symbol in ((known[0], "start", "circle"), (known[-1], "end", "square")):
                more = {"showlegend": False, "hovertext": what, **group}
                _marker(figure, at_m, side.name, symbol, color, **more)
    if not figure.data:
        return None
    return layout_3d(
        figure,
        ("x, east [m]", "y, north [m]", "z, up [m]"),
        zaxis={"rangemode": "tozero"},
        aspectmode="data",
        camera={"eye": {"x": 0.9, "y": -1.5, "z": 0.9}, "center": {"x": 0.0, "y": 0.0, "z": -0.15}},
    )


def _line_3d(
    figure: go.Figure, points_m: Floats, name: str, color: str, width: float, dash: str = "solid", **more: Any
) -> None:
    x, y, z = light(points_m[thin(len(points_m))]).T
    style = {"color": color, "width": width, "dash": dash}
    figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="lines", line=style, name=name, **more))


def _marker(figure: go.Figure, at: Floats, name: str, symbol: str, color: str, **more: Any) -> None:
    """Add a marker at a point with two or three coordinates."""
    places = {axis: [float(value)] for axis, value in zip("xyz", at, strict=False)}
    edge, flat = color if symbol.endswith("open") else "white", len(at) == 2
    style = {"symbol": symbol, "size": 12 if flat else 6, "color": color, "line": {"color": edge, "width": 1}}
    draw = go.Scatter if flat else go.Scatter3d
    figure.add_trace(draw(**places, mode="markers", name=name, marker=style, **more))
