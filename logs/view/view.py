"""Converts a flight log into a Rerun recording: scene, curves and events, with a layout for landings.

Rerun can open the MCAP file directly, too, but draws neither markers nor odometry and has no layout.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import rerun as rr

from flightstack.common.text import one_line
from logs import curves
from logs.reader.flight import load_fleet
from logs.reader.flight_data import Event, Flight, Floats, Ints, Steps, phase_name
from logs.recorder import markers
from logs.schema import FLEET
from logs.schema.events import Severity
from logs.view.canvas import EVENTS, PHASE, RUN, WORLD, Canvas, blueprint, rgba, run_of, times

BODY_HALF_M = tuple(0.5 * size for size in markers.BODY_SIZE_M)
ARROW_RADIUS_M, LINE_RADIUS_M, ELLIPSOID_LINE_M = 0.006, 0.004, 0.001
SPOT = f"{WORLD}/target_pad"
TRUE_COLOR: markers.Color = (0.5, 0.5, 0.5, 1.0)
# arrows: entity, velocity of each step, colour
VELOCITIES: tuple[tuple[str, Callable[[Steps], Floats], str], ...] = (
    ("nominal", lambda steps: steps.nominal_enu_m_s, curves.NOMINAL),
    ("filtered", lambda steps: steps.filtered_enu_m_s, curves.FILTERED),
    ("command", curves.sent_m_s, curves.COMMAND),
    ("flown", curves.flown_m_s, curves.FLOWN),
)
_LEVELS: dict[int, str] = {
    Severity.DEBUG: "DEBUG",
    Severity.INFO: "INFO",
    Severity.WARN: "WARN",
    Severity.ERROR: "ERROR",
    Severity.FATAL: "CRITICAL",
}


class Recording:
    def __init__(self, log: Path) -> None:
        self._fleet = load_fleet(log)
        first = next(iter(self._fleet.flights.values()))
        self.problem = "; ".join(first.damage)
        told = self._fleet.metadata.get(FLEET, run_of(first))
        self._stream = rr.RecordingStream("flightstack")
        self._stream.send_recording_name(f"{told.get('scenario', 'flight')}: {log.name}")

    def save(self, out: Path) -> None:
        fleet, flights = self._fleet, self._fleet.flights.values()
        members = [flight.label for flight in flights if flight.label]
        self._stream.save(out, default_blueprint=blueprint(members))
        for number, flight in enumerate(flights):
            color = markers.COLORS[number % len(markers.COLORS)]
            draw(Canvas(self._stream, fleet.origin_ns, flight.label, color), flight)
        events(Canvas(self._stream, fleet.origin_ns), fleet.origin_ns, fleet.events)
        self._stream.flush()
        self._stream.disconnect()


def open_viewer(recording: Path, *, web: bool) -> int:
    """Show an ``.rrd`` file in Rerun until it is closed; return the exit status."""
    program = viewer_program()
    # The flight is shown only on this machine; by default Rerun would listen on every network.
    serving = ["--serve-web", "--port", "auto", "--web-viewer-port", "0"] if web else []  # 0: any free port
    return subprocess.run([program, str(recording), "--bind", "127.0.0.1", *serving], check=False).returncode


def viewer_program() -> str:
    """Return the path of Rerun's program.

    ``bin/rerun`` is a Python program that starts this one, and leaves it running after SIGTERM.
    """
    return str(files("rerun_cli") / "rerun")


def draw(canvas: Canvas, flight: Flight) -> None:
    """Send a complete flight, or its next part, to the viewer."""
    for part in (_scene, _velocities, _truth, _curves):
        part(canvas, flight)
    canvas.style(RUN, rr.TextDocument(_run_text(flight)))


def _scene(canvas: Canvas, flight: Flight) -> None:
    """Send the controller's data: vehicle, target with its pad and barrier, both paths."""
    canvas.style(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    steps, run = flight.steps, run_of(flight)
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
        if name == "target":  # the barrier moves with the target but does not rotate with it
            canvas.columns(SPOT, at_ns[valid], rr.Transform3D.columns(translation=place_m))
    scene = markers.Scene("vehicle", "target")
    scene.configure(run)
    for shape in scene.shapes:
        own = shape.frame_id == "vehicle"
        drawn = _shape(shape, canvas.own_color if own else shape.color, canvas.member if own else "")
        canvas.style(f"{WORLD}/{shape.frame_id}/{shape.ns}", drawn)
    _paths(canvas, flight)


def _truth(canvas: Canvas, flight: Flight) -> None:
    """Send the simulator's true states, if there are any."""
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
    """Convert a marker into a shape of Rerun."""
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
        if (marker := path.marker(0, markers.TARGET_COLOR)) is not None:
            strip = np.frombuffer(marker.points, dtype="<f8").reshape(-1, 3)
            drawn = rr.LineStrips3D([strip], radii=[LINE_RADIUS_M], colors=[rgba(color)])
            canvas.style(f"{WORLD}/{name}", drawn, again=True)


def _velocities(canvas: Canvas, flight: Flight) -> None:
    """Draw velocity arrows that start at the vehicle, 1 m for 1 m/s; an unknown velocity has no arrow."""
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


def _run_text(flight: Flight) -> str:
    lines = [f"the log is broken: {'; '.join(flight.damage)}"] if flight.damage else []
    lines += [f"{key} = {value}" for key, value in run_of(flight).items()]
    return "\n".join(map(one_line, lines)) or "no metadata"
