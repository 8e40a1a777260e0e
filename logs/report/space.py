"""Spatial figures: the landing relative to the pad (paper Fig. 7, 8, 10, 11), and paths in the world (12)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import plotly.graph_objects as go

from flightstack.core.safety.barrier import Barrier
from logs.curves import BOUNDARY, ESTIMATED, INK, LIMIT, TARGET, TRUE
from logs.reader.flight_data import Flight, Floats
from logs.recorder.markers import COLORS
from logs.report.derived import Side, touch_index
from logs.report.style import (
    UNSAFE,
    layout,
    layout_3d,
    light,
    line,
    thin,
)

_SURFACE_RINGS, _SURFACE_SPOKES = 48, 73
_SURFACE_COLORS = [[0.0, "#fff3c4"], [0.5, "#f7b267"], [1.0, "#d55e00"]]  # low to high, as in the paper
_DISTANCE_MIN_M = 0.6  # smallest range of the distance axis, m, so that the cone is visible
_BEFORE = "#9aa5b1"
_SYMBOLS_3D = {"circle": "circle", "square-open": "square", "triangle-up": "diamond"}


class Track(NamedTuple):
    """A path to draw: name, colour, dash, and relative positions since the landing began, m, (n, 3)."""

    name: str
    color: str
    dash: str
    points_m: Floats


def relative_tracks(flight: Flight) -> list[Track]:
    """Return the path relative to the landing spot since the landing began: estimated and, if known, true."""
    start_s = flight.landing_start_s or 0.0
    tracks = []
    if flight.steps is not None:
        seen = flight.steps.e_m[flight.steps.t_s >= start_s]
        tracks.append(Track("estimate", ESTIMATED, "solid" if flight.truth is None else "dash", seen))
    if flight.truth is not None:
        tracks.append(Track("true", TRUE, "solid", flight.truth.e_m[flight.truth.t_s >= start_s]))
    return [t for t in tracks if np.isfinite(t.points_m).all(1).any()]


def _distance_max_m(tracks: list[Track]) -> float:
    far = [float(np.nanmax(np.hypot(t.points_m[:, 0], t.points_m[:, 1]))) for t in tracks]
    return 1.1 * max([_DISTANCE_MIN_M, *far])


def trajectory_3d(flight: Flight) -> go.Figure | None:
    """Draw the relative trajectory over the barrier's surface."""
    tracks = relative_tracks(flight)
    if not tracks:
        return None
    figure = go.Figure()
    if flight.barrier is not None:
        figure.add_trace(_surface(flight.barrier, _distance_max_m(tracks)))
    angle = np.linspace(0.0, 2.0 * np.pi, 61)
    rim_m = flight.pad_radius_m * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(61)))
    _line_3d(figure, rim_m, "rim of the pad", TARGET, 6)
    for track in tracks:
        width = 7 if track.dash == "solid" else 4
        _line_3d(figure, track.points_m, f"vehicle ({track.name})", track.color, width, track.dash)
    places = _places(flight, tracks[-1].points_m)
    for name, at_m, symbol in places:
        _marker_3d(figure, at_m, name, _SYMBOLS_3D[symbol], INK)
    return layout_3d(
        figure,
        ("e<sub>x</sub>, east [m]", "e<sub>y</sub>, north [m]", "e<sub>z</sub>, up [m]"),
        aspectmode="manual",  # heights have a larger scale than distances, as in the paper's figures
        aspectratio={"x": 1.3, "y": 1.3, "z": 0.75},
        camera={"eye": _camera(places[0][1]), "center": {"x": 0.0, "y": 0.0, "z": -0.2}},
    )


def _camera(start_m: Floats) -> dict[str, float]:
    """Place the camera beside the approach, so that the path is in front of the surface."""
    bearing = float(np.arctan2(start_m[1], start_m[0])) - 0.9
    return {"x": 1.8 * float(np.cos(bearing)), "y": 1.8 * float(np.sin(bearing)), "z": 0.9}


def _surface(barrier: Barrier, distance_max_m: float) -> go.Surface:
    # rings are closer together near the apex, where the boundary bends
    d = distance_max_m * np.linspace(0.0, 1.0, _SURFACE_RINGS) ** 1.4
    angle = np.linspace(0.0, 2.0 * np.pi, _SURFACE_SPOKES)
    height = np.repeat(np.vectorize(barrier.height)(d)[:, None], len(angle), axis=1)
    rings = float(height.max()) / 6.0
    contour = {
        "show": True,
        "color": "rgba(110, 50, 0, 0.45)",
        "start": rings,
        "end": 6 * rings,
        "size": rings,
    }
    return go.Surface(
        x=light(np.outer(d, np.cos(angle))), y=light(np.outer(d, np.sin(angle))), z=light(height),
        colorscale=_SURFACE_COLORS, showscale=False, opacity=0.55, name="h = 0", showlegend=True,
        contours={"z": contour}, hoverinfo="skip",
    )  # fmt: skip


def altitude_over_distance(flight: Flight) -> go.Figure | None:
    """Draw e_z over d with the boundary."""
    tracks = relative_tracks(flight)
    if not tracks:
        return None
    figure, far = go.Figure(), _distance_max_m(tracks)
    heights = np.concatenate([t.points_m[:, 2] for t in tracks])
    bottom, top = min(-0.05, float(np.nanmin(heights)) - 0.03), float(np.nanmax(heights))
    if flight.barrier is not None:
        d = np.linspace(0.0, far, 300)
        b = np.vectorize(flight.barrier.height)(d)
        top, floor = max(top, float(b.max())), np.full_like(d, bottom - 1.0)
        figure.add_trace(line(d, floor, "", "rgba(0,0,0,0)", showlegend=False, hoverinfo="skip"))
        name = "boundary h = 0, unsafe below"
        figure.add_trace(line(d, b, name, BOUNDARY, width=2.2, fill="tonexty", fillcolor=UNSAFE))
    for track in tracks:
        distance = np.hypot(track.points_m[:, 0], track.points_m[:, 1])
        look = {"dash": track.dash, "width": 2.4 if track.dash == "solid" else 1.6}
        name = f"vehicle ({track.name})"
        figure.add_trace(line(distance, track.points_m[:, 2], name, track.color, **look))
    for name, e_m, symbol in _places(flight, tracks[-1].points_m):  # the last track is the most accurate one
        marker(figure, float(np.hypot(e_m[0], e_m[1])), float(e_m[2]), name, symbol, INK, showlegend=True)
    figure.add_vline(
        flight.pad_radius_m, line={"color": LIMIT, "width": 1, "dash": "dot"},
        annotation={"text": "pad radius", "font": {"size": 12, "color": LIMIT}, "yanchor": "top"},
    )  # fmt: skip
    layout(figure, 460)
    figure.update_xaxes(title_text="horizontal distance d [m]", range=[0.0, far])
    figure.update_yaxes(title_text="relative altitude e<sub>z</sub> [m]", range=[bottom, top * 1.08])
    return figure


def _places(flight: Flight, path_m: Floats) -> list[tuple[str, Floats, str]]:
    """Return name, position and symbol of a path's start, first contact and end; needs a known position."""
    known, touch = path_m[np.isfinite(path_m).all(1)], touch_index(flight)
    found = [("start", known[0], "circle"), ("end", known[-1], "square-open")]
    if touch is not None and flight.truth is not None:
        found.append(("touchdown", flight.truth.e_m[touch], "triangle-up"))
    return found


class Path(NamedTuple):
    """A path of vehicle or target in the world."""

    body: str  # moving body: "vehicle" or "target"
    source: str  # source of the positions: "true" or "estimate"
    t_s: Floats
    points_m: Floats  # positions in the world, m, (n, 3); NaN where unknown


def paths(flight: Flight) -> list[Path]:
    """Return the paths of vehicle and target that the log contains; true paths are first."""
    steps, truth, found = flight.steps, flight.truth, []
    if truth is not None:
        found.append(Path("vehicle", "true", truth.t_s, truth.position_enu_m))
        found.append(Path("target", "true", truth.t_s, truth.pad_position_enu_m))
    if steps is not None:
        own = np.where(steps.own_valid[:, None], steps.own_position_enu_m, np.nan)
        target = np.where(steps.target_valid[:, None], steps.target_position_enu_m, np.nan)
        found.append(Path("vehicle", "estimate", steps.t_s, own))
        found.append(Path("target", "estimate", steps.t_s, target))
    return [path for path in found if np.isfinite(path.points_m).all(1).any()]


def plan(flight: Flight) -> go.Figure | None:
    """Draw the paths from above, since the landing began and, of the vehicle, also before."""
    figure, found = go.Figure(), paths(flight)
    for path in found:
        best, vehicle = path.source == found[0].source, path.body == "vehicle"
        since = path.t_s >= (flight.landing_start_s or 0.0)
        color = TARGET if not vehicle else TRUE if path.source == "true" else ESTIMATED
        if vehicle and best and not since.all():
            x, y, _ = path.points_m[~since].T
            figure.add_trace(line(x, y, "before the landing", _BEFORE, dash="dot", width=1.2))
        x, y, _ = path.points_m[since].T
        look = {"width": 2.2, "dash": "solid"} if best else {"width": 1.5, "dash": "dash"}
        figure.add_trace(line(x, y, f"{path.body} ({path.source})", color, **look))
        known = path.points_m[since & np.isfinite(path.points_m).all(1)]
        if best and len(known) and not vehicle:
            circle(figure, known[-1], flight.pad_radius_m, color)
        elif best and len(known):
            for (x, y, _), what, symbol in ((known[0], "start", "circle"), (known[-1], "end", "square")):
                marker(figure, x, y, what, symbol, color, showlegend=False)
    touch = touch_index(flight)
    if touch is not None and flight.truth is not None:
        x, y, _ = flight.truth.position_enu_m[touch]
        marker(figure, x, y, "touchdown", "triangle-up", INK)
    if not figure.data:
        return None
    layout(figure, 540)
    figure.update_xaxes(title_text="east x [m]", constrain="domain")
    figure.update_yaxes(title_text="north y [m]", scaleanchor="x", scaleratio=1)
    return figure


def room_3d(sides: Sequence[Side]) -> go.Figure:
    """Draw all paths in 3-D, with heights and distances at the same scale."""
    figure = go.Figure()
    for number, side in enumerate(sides):
        color, group = COLORS[number % len(COLORS)], {"legendgroup": side.name}
        for path in paths(side.flight)[:2]:
            if path.body == "target":
                _line_3d(figure, path.points_m, f"{side.name} pad", color, 4, "dot", **group)
                continue
            dash = "solid" if path.source == "true" else "dash"
            _line_3d(figure, path.points_m, side.name, color, 6, dash, **group)
            known = path.points_m[np.isfinite(path.points_m).all(1)]
            for at_m, what, symbol in zip(
                known[[0, -1]], ("start", "end"), ("circle", "square"), strict=True
            ):
                more = {"showlegend": False, "hovertext": what, **group}
                _marker_3d(figure, at_m, side.name, symbol, color, **more)
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


def _marker_3d(figure: go.Figure, at_m: Floats, name: str, symbol: str, color: str, **more: Any) -> None:
    x, y, z = ([float(v)] for v in at_m)
    style = {"symbol": symbol, "size": 6, "color": color, "line": {"color": "white", "width": 1}}
    figure.add_trace(go.Scatter3d(x=x, y=y, z=z, mode="markers", name=name, marker=style, **more))


def marker(figure: go.Figure, x: float, y: float, name: str, symbol: str, color: str, **more: Any) -> None:
    edge = color if symbol.endswith("open") else "white"
    style = {"symbol": symbol, "size": 12, "color": color, "line": {"color": edge, "width": 1.5}}
    figure.add_trace(go.Scatter(x=[float(x)], y=[float(y)], mode="markers", name=name, marker=style, **more))


def circle(figure: go.Figure, center_m: Floats, radius_m: float, color: str) -> None:
    x, y, r = center_m[0], center_m[1], radius_m
    figure.add_shape(
        type="circle", x0=x - r, x1=x + r, y0=y - r, y1=y + r, line={"color": color, "width": 1.2}
    )
