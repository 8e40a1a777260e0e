"""Converts a flight log into a Rerun recording: scene, curves and events, with a layout for landings.

Rerun can also open the MCAP file directly, but then draws neither markers nor odometry and has no layout.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs import curves
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Event, Flight, Floats, Ints, Steps, phase_name, sizes_of
from logs.recorder import markers
from logs.schema import FLEET
from logs.schema.events import Severity

FLIGHT = "flight"  # timeline of seconds since the first step
LOG_TIME = "log_time"  # timeline of date and time in the log
EVENTS, WORLD, PHASE = "/events", "/world", "/phase"
BODY_HALF_M = tuple(0.5 * size for size in markers.BODY_SIZE_M)
ARROW_RADIUS_M, LINE_RADIUS_M, ELLIPSOID_LINE_M = 0.006, 0.004, 0.001
SPOT = f"{WORLD}/target_pad"
TRUE_COLOR: markers.Color = (0.5, 0.5, 0.5, 1.0)
# velocity arrows; fields: entity, function that returns the velocity of each step, colour
VELOCITIES: tuple[tuple[str, Callable[[Steps], Floats], str], ...] = (
    ("nominal", lambda steps: steps.nominal_enu_m_s, curves.NOMINAL),
    ("filtered", lambda steps: steps.filtered_enu_m_s, curves.FILTERED),
    ("command", curves.sent_m_s, curves.COMMAND),
    ("flown", curves.flown_m_s, curves.FLOWN),
)
_LEVELS: dict[int, str] = dict(zip(Severity, ("DEBUG", "INFO", "WARN", "ERROR", "CRITICAL"), strict=True))


def blueprint(members: Sequence[str]) -> Any:
    """Return the layout of the viewer for these vehicles; the viewer places the camera by itself."""
    scene = rrb.Spatial3DView(origin=WORLD, name="Scene: ENU, metres", line_grid=rrb.LineGrid3D(spacing=0.25))
    phases = [f"+ {of_member(PHASE, member)}" for member in members]
    tabs: list[Any] = [rrb.Tabs(*_tabs(member), name=member, active_tab=0) for member in members]
    tabs.append(rrb.StateTimelineView(origin="/", contents=phases, name="All phases"))
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                scene,
                rrb.TextLogView(
                    origin=EVENTS,
                    name="Events",
                    columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
                ),
                row_shares=[3, 1],
            ),
            rrb.Tabs(*tabs, active_tab=0),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=FLIGHT),
        auto_views=False,
        auto_layout=False,
    )


def _tabs(member: str) -> Iterator[Any]:
    """Yield a tab for each chart with the curves of a flight; the first tab also shows the phases."""
    for number, chart in enumerate(curves.CHARTS):
        origins = {of_member(f"/{chart.key}/{row.key}", member): row.title for row in chart.rows}
        views: list[Any] = [rrb.TimeSeriesView(origin=origin, name=name) for origin, name in origins.items()]
        if not number:
            views.append(rrb.StateTimelineView(origin=of_member(PHASE, member), name="Phase"))
        yield rrb.Vertical(*views, name=chart.key.capitalize())


def of_member(entity: str, member: str) -> str:
    """Return the name of a member's entity: below the common world, or else below the member's name."""
    if not member or entity == WORLD:
        return entity
    inner = entity.removeprefix(f"{WORLD}/")
    return f"/{member}{entity}" if inner == entity else f"{WORLD}/{member}/{inner}"


class Canvas:
    """A Rerun recording stream, and the state that a part of a flight needs from the previous part."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        origin_ns: int,
        member: str = "",
        own_color: markers.Color | str = markers.OWN_COLOR,
    ) -> None:
        self.stream, self.member, self.own_color = stream, member, own_color
        self.paths: dict[str, markers.Path] = {}  # past positions of vehicle and target, by entity
        self.phase: int | None = None  # phase of the newest step sent to the viewer
        self._origin_ns = origin_ns
        self._styled: set[str] = set()

    def style(self, entity: str, archetype: rr.AsComponents, *, again: bool = False) -> None:
        """Send data of an entity that do not change with time, at the first call or if ``again`` is True."""
        if again or entity not in self._styled:
            self._styled.add(entity)
            self.stream.log(of_member(entity, self.member), archetype, static=True)

    def columns(self, entity: str, at_ns: Ints, columns: Iterable[Any]) -> None:
        """Send values of an entity at log times in ns."""
        self.stream.send_columns(
            of_member(entity, self.member),
            (
                rr.TimeColumn(FLIGHT, duration=(at_ns - self._origin_ns).astype("timedelta64[ns]")),
                rr.TimeColumn(LOG_TIME, timestamp=at_ns.astype("datetime64[ns]")),
            ),
            columns,
        )


def times(origin_ns: int, t_s: Floats) -> Ints:
    """Convert times since the origin into log times in ns, (n,)."""
    return origin_ns + np.round(t_s * 1e9).astype(np.int64)


def rgba(color: markers.Color | str) -> tuple[int, int, int, int]:
    """Return a colour as four numbers from 0 to 255 for Rerun, from fractions or from hexadecimal."""
    if isinstance(color, str):
        red, green, blue = bytes.fromhex(color.removeprefix("#"))
        return red, green, blue, 255
    r, g, b, opacity = (round(255 * part) for part in color)
    return r, g, b, opacity


def save(log: Path, out: Path) -> str:
    """Write a log as a recording; return the problems of the log, as text."""
    fleet = load_fleet(log)
    first = next(iter(fleet.flights.values()))
    told = fleet.metadata.get(FLEET, first.metadata.get("run", {}))
    stream = rr.RecordingStream("flightstack")
    stream.send_recording_name(f"{told.get('scenario', 'flight')}: {log.name}")
    stream.save(out, default_blueprint=blueprint(list(fleet.flights)))
    for number, (member, flight) in enumerate(fleet.flights.items()):
        color = markers.COLORS[number % len(markers.COLORS)]
        draw(Canvas(stream, fleet.origin_ns, member, color), flight)
    events(Canvas(stream, fleet.origin_ns), fleet.origin_ns, fleet.events)
    stream.flush()
    stream.disconnect()
    return "; ".join(first.problems)


def open_viewer(recording: Path, *, web: bool) -> int:
    """Show an ``.rrd`` file in Rerun until the viewer is closed; return the viewer's exit status."""
    program = viewer_program()
    # The flight is shown only on this machine; by default Rerun would listen on every network.
    serving = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"] if web else []  # 0: any free port
    return subprocess.run([program, str(recording), "--bind", "127.0.0.1", *serving], check=False).returncode


def viewer_program() -> str:
    """Return the path of Rerun's program.

    The path is not ``bin/rerun``: that Python wrapper leaves the program running after SIGTERM.
    """
    return str(files("rerun_cli") / "rerun")


def draw(canvas: Canvas, flight: Flight) -> None:
    """Send a complete flight, or its next part, to the viewer."""
    for part in (_scene, _velocities, _truth, _curves):
        part(canvas, flight)


def _scene(canvas: Canvas, flight: Flight) -> None:
    """Send the controller's data: vehicle, target with pad and boundary h = 0, both paths."""
    canvas.style(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    steps = flight.steps
    if steps is None:
        return
    at_ns = times(flight.origin_ns, steps.t_s)
    for name, valid, position_m, yaw_rad in (
        ("vehicle", steps.own_valid, steps.own_position_enu_m, steps.own_yaw_rad),
        ("target", steps.target_valid, steps.target_position_enu_m, steps.target_yaw_rad),
    ):
        place_m, half_rad = position_m[valid], 0.5 * yaw_rad[valid]
        nothing = np.zeros_like(half_rad)
        turn = np.stack([nothing, nothing, np.sin(half_rad), np.cos(half_rad)], axis=1)
        moved = rr.Transform3D.columns(translation=place_m, quaternion=turn)
        canvas.columns(f"{WORLD}/{name}", at_ns[valid], moved)
        if name == "target":  # the boundary h = 0 moves with the target but does not rotate
            canvas.columns(SPOT, at_ns[valid], rr.Transform3D.columns(translation=place_m))
    sizes = sizes_of(flight.config, flight.metadata.get("run", {}))
    for shape in markers.shapes("vehicle", "target", sizes):
        own = shape.frame_id == "vehicle"
        drawn = _shape(shape, canvas.own_color if own else shape.color, canvas.member if own else "")
        canvas.style(f"{WORLD}/{shape.frame_id}/{shape.ns}", drawn)
    _paths(canvas, flight)


def _truth(canvas: Canvas, flight: Flight) -> None:
    if flight.truth is None:
        return
    at_ns = times(flight.origin_ns, flight.truth.t_s)
    moved = rr.Transform3D.columns(
        translation=flight.truth.position_enu_m, quaternion=flight.truth.orientation
    )
    canvas.columns(f"{WORLD}/true_vehicle", at_ns, moved)
    body = rr.Boxes3D(half_sizes=[BODY_HALF_M], colors=[rgba(TRUE_COLOR)])
    canvas.style(f"{WORLD}/true_vehicle/body", body)


def _shape(shape: markers.Marker, color: markers.Color | str, label: str) -> rr.AsComponents:
    half_m, colors = [0.5 * size for size in shape.scale], [rgba(color)]
    if shape.kind == markers.CUBE:
        labels = [label] if label else None
        return rr.Boxes3D(half_sizes=[half_m], colors=colors, fill_mode="solid", labels=labels)
    if shape.kind == markers.SPHERE:
        return rr.Ellipsoids3D(
            half_sizes=[half_m], colors=colors, line_radii=[ELLIPSOID_LINE_M], fill_mode="majorwireframe"
        )
    if shape.kind == markers.CYLINDER:
        return rr.Cylinders3D(
            lengths=[shape.scale[2]], radii=[half_m[0]], centers=[shape.position], colors=colors,
            fill_mode="solid",
        )  # fmt: skip
    corners = np.frombuffer(shape.points, dtype="<f8").reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=corners, triangle_indices=triangles, vertex_normals=_normals(corners),
        albedo_factor=colors[0], face_rendering="DoubleSided",
    )  # fmt: skip


def _normals(corners: Floats) -> Floats:
    """Return unit normals of triangles, one per corner and all upwards, so that shading shows the shape."""
    a, b, c = corners[0::3], corners[1::3], corners[2::3]
    normal = np.cross(b - a, c - a)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal, 3, axis=0)


def _paths(canvas: Canvas, flight: Flight) -> None:
    """Send the paths of vehicle and target up to the end of the data, shown at all times."""
    steps = flight.steps
    assert steps is not None
    at_ns = times(flight.origin_ns, steps.t_s)
    for name, valid, position_m, color in (
        ("vehicle_path", steps.own_valid, steps.own_position_enu_m, canvas.own_color),
        ("target_path", steps.target_valid, steps.target_position_enu_m, markers.TARGET_COLOR),
    ):
        path = canvas.paths.setdefault(name, markers.Path())
        for time_ns, (x, y, z) in zip(at_ns[valid].tolist(), position_m[valid].tolist(), strict=True):
            path.add(time_ns, (x, y, z))
        drawn = rr.LineStrips3D([path.points], radii=[LINE_RADIUS_M], colors=[rgba(color)])
        canvas.style(f"{WORLD}/{name}", drawn, again=True)


def _velocities(canvas: Canvas, flight: Flight) -> None:
    """Draw velocity arrows from the vehicle, 1 m long for 1 m/s; an unknown velocity has no arrow."""
    steps = flight.steps
    if steps is None:
        return
    at_ns = times(flight.origin_ns, steps.t_s)
    for name, value, color in VELOCITIES:
        vector = value(steps)
        there = np.isfinite(vector).all(axis=1) & steps.own_valid
        columns = rr.Arrows3D.columns(vectors=vector[there], origins=steps.own_position_enu_m[there])
        canvas.columns(f"{WORLD}/velocity/{name}", at_ns, columns.partition(there.astype(int)))
        style = rr.Arrows3D.from_fields(radii=[ARROW_RADIUS_M], colors=[rgba(color)])
        canvas.style(f"{WORLD}/velocity/{name}", style)


def _curves(canvas: Canvas, flight: Flight) -> None:
    """Send the curves of all charts, with a gap for each unknown number."""
    for chart in curves.CHARTS:
        for row in chart.rows:
            for curve in row.curves:
                found = None if curve.symbol else curve.values(flight)
                if found is not None:
                    entity = f"/{chart.key}/{row.key}/{curve.key}"
                    canvas.style(entity, rr.SeriesLines(colors=[rgba(curve.color)], names=[curve.name]))
                    at_ns = times(flight.origin_ns, found[0])
                    canvas.columns(entity, at_ns, rr.Scalars.columns(scalars=found[1]))
    if flight.steps is not None:
        _phases(canvas, times(flight.origin_ns, flight.steps.t_s), flight.steps.phase)


def _phases(canvas: Canvas, at_ns: Ints, phase: Ints) -> None:
    before = np.concatenate(([-1 if canvas.phase is None else canvas.phase], phase[:-1]))
    begins = np.flatnonzero(phase != before)
    canvas.phase = int(phase[-1])
    names = [phase_name(number) for number in phase[begins].tolist()]
    canvas.columns(PHASE, at_ns[begins], rr.StateChange.columns(state=names))


def events(canvas: Canvas, origin_ns: int, said: Sequence[Event]) -> None:
    if said:
        texts = [f"{event.source}: {event.text}" for event in said]
        levels = [_LEVELS.get(event.level, "INFO") for event in said]
        at_ns = times(origin_ns, np.array([event.t_s for event in said]))
        canvas.columns(EVENTS, at_ns, rr.TextLog.columns(text=texts, level=levels))
