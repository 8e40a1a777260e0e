"""The three-dimensional part of a Rerun recording: barrier, pad, vehicle, paths and velocities."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from flightstack.core.safety.barrier import Barrier
from logs.derive.markers import (
    BARRIER_COLOR,
    BODY_SIZE_M,
    COMMAND_COLOR,
    FILTERED_COLOR,
    NOMINAL_COLOR,
    PAD_COLOR,
    TARGET_COLOR,
    Color,
    Path,
    reach_of,
    surface,
)
from logs.reader.flight_data import PAD_RADIUS_M, Flight, Floats
from logs.view.canvas import WORLD, Canvas, every, rgba, run_of, times

SCENE_PERIOD_NS = 20_000_000  # period of 50 Hz
PATH_PERIOD_NS = 200_000_000  # period of the paths, 5 Hz; each row stores the whole path again
BODY_HALF_M = tuple(0.5 * size for size in BODY_SIZE_M)
ARROW_RADIUS_M, LINE_RADIUS_M, ELLIPSOID_LINE_M = 0.006, 0.004, 0.001
SPOT = f"{WORLD}/target_spot"
FLOWN_COLOR: Color = (0.12, 0.47, 0.71, 1.0)
TRUE_COLOR: Color = (0.5, 0.5, 0.5, 1.0)
VELOCITIES = (
    ("nominal", "nominal_enu_m_s", NOMINAL_COLOR),
    ("filtered", "filtered_enu_m_s", FILTERED_COLOR),
    ("command", "command_enu_m_s", COMMAND_COLOR),
    ("flown", "own_velocity_enu_m_s", FLOWN_COLOR),
)


def scene(canvas: Canvas, flight: Flight) -> None:
    """Send the controller's data: vehicle, target with its pad and barrier, both paths."""
    canvas.style(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    steps, run = flight.steps, run_of(flight)
    if steps is None:
        return
    at_ns = times(flight.origin_ns, steps.t_s)
    shown = every(at_ns, SCENE_PERIOD_NS)
    for name, valid, position_m, yaw_rad in (
        ("vehicle", steps.own_valid, steps.own_position_enu_m, steps.own_yaw_rad),
        ("target", steps.target_valid, steps.target_position_enu_m, steps.target_yaw_rad),
    ):
        good = shown[valid[shown]]
        place_m, half_rad = position_m[good], 0.5 * yaw_rad[good]
        nothing = np.zeros_like(half_rad)
        turn = np.stack([nothing, nothing, np.sin(half_rad), np.cos(half_rad)], axis=1)
        moved = rr.Transform3D.columns(translation=place_m, quaternion=turn)
        canvas.columns(f"{WORLD}/{name}", at_ns[good], moved)
        if name == "target":  # the barrier moves with the target but does not rotate with it
            canvas.columns(SPOT, at_ns[good], rr.Transform3D.columns(translation=place_m))
    canvas.style(
        f"{WORLD}/vehicle/body",
        rr.Boxes3D(
            half_sizes=[BODY_HALF_M], colors=[rgba(canvas.own_color)], fill_mode="solid",
            labels=[canvas.member] if canvas.member else None,
        ),
    )  # fmt: skip
    if "ellipsoid_xy_m" in run and "ellipsoid_z_m" in run:  # two such ellipsoids touch at the distance limit
        beside_m, above_m = 0.5 * float(run["ellipsoid_xy_m"]), 0.5 * float(run["ellipsoid_z_m"])
        canvas.style(
            f"{WORLD}/vehicle/ellipsoid",
            rr.Ellipsoids3D(
                half_sizes=[(beside_m, beside_m, above_m)], colors=[rgba(canvas.own_color)],
                line_radii=[ELLIPSOID_LINE_M], fill_mode="majorwireframe",
            ),
        )  # fmt: skip
    radius_m, thickness_m = float(run.get("pad_radius_m", PAD_RADIUS_M)), 0.01
    canvas.style(
        f"{WORLD}/target/pad",
        rr.Cylinders3D(
            lengths=[thickness_m], radii=[radius_m], centers=[(0.0, 0.0, -0.5 * thickness_m)],
            colors=[rgba(PAD_COLOR)], fill_mode="solid",
        ),
    )  # fmt: skip
    _barrier(canvas, run)
    _paths(canvas, flight)


def truth(canvas: Canvas, flight: Flight) -> None:
    """Send the simulator's true states, if there are any."""
    if flight.truth is None:
        return
    at_ns = times(flight.origin_ns, flight.truth.t_s)
    shown = every(at_ns, SCENE_PERIOD_NS)
    moved = rr.Transform3D.columns(
        translation=flight.truth.position_enu_m[shown], quaternion=flight.truth.orientation[shown]
    )
    canvas.columns(f"{WORLD}/true_vehicle", at_ns[shown], moved)
    body = rr.Boxes3D(half_sizes=[BODY_HALF_M], colors=[rgba(TRUE_COLOR)])
    canvas.style(f"{WORLD}/true_vehicle/body", body)


def _barrier(canvas: Canvas, run: Mapping[str, str]) -> None:
    if "barrier_alpha_1_m" not in run or "barrier_beta_m" not in run:
        return
    barrier = Barrier(float(run["barrier_alpha_1_m"]), float(run["barrier_beta_m"]))
    if barrier.alpha_1_m <= 0.0:
        return
    corners = np.frombuffer(surface(barrier, reach_of(run)), dtype="<f8").reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    mesh = rr.Mesh3D(
        vertex_positions=corners, triangle_indices=triangles, vertex_normals=_normals(corners),
        albedo_factor=rgba(BARRIER_COLOR), face_rendering="DoubleSided",
    )  # fmt: skip
    canvas.style(f"{SPOT}/barrier", mesh)


def _normals(corners: Floats) -> Floats:
    """Return unit normals of triangles, one per corner and all upwards, so that shading shows the shape."""
    a, b, c = corners[0::3], corners[1::3], corners[2::3]
    normal = np.cross(b - a, c - a)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal, 3, axis=0)


def _paths(canvas: Canvas, flight: Flight) -> None:
    """Send both paths as they grow."""
    steps = flight.steps
    assert steps is not None
    for name, valid, position_m, color in (
        ("vehicle_path", steps.own_valid, steps.own_position_enu_m, canvas.own_color),
        ("target_path", steps.target_valid, steps.target_position_enu_m, TARGET_COLOR),
    ):
        path = canvas.paths.setdefault(name, Path())
        strips, at_ns = [], []
        for time_ns, known, (x, y, z) in zip(
            times(flight.origin_ns, steps.t_s).tolist(), valid, position_m.tolist(), strict=True
        ):
            if known:
                path.add(time_ns, (x, y, z))
            if not canvas.due(name, PATH_PERIOD_NS, time_ns):
                continue
            if (marker := path.marker(0, TARGET_COLOR)) is not None:
                strips.append(np.frombuffer(marker.points, dtype="<f8").reshape(-1, 3))
                at_ns.append(time_ns)
        if strips:
            canvas.columns(
                f"{WORLD}/{name}", np.array(at_ns, dtype=np.int64), rr.LineStrips3D.columns(strips=strips)
            )
            style = rr.LineStrips3D.from_fields(radii=[LINE_RADIUS_M], colors=[rgba(color)])
            canvas.style(f"{WORLD}/{name}", style)


def velocities(canvas: Canvas, flight: Flight) -> None:
    """Send velocity arrows at the vehicle, one metre per m/s; none for an unknown velocity."""
    steps = flight.steps
    if steps is None:
        return
    at_ns = times(flight.origin_ns, steps.t_s)
    shown = every(at_ns, SCENE_PERIOD_NS)
    for name, field, color in VELOCITIES:
        vector = getattr(steps, field)[shown]
        there = np.isfinite(vector).all(axis=1) & steps.own_valid[shown]
        if name == "command":
            there &= steps.setpoint_sent[shown]
        columns = rr.Arrows3D.columns(vectors=vector[there], origins=steps.own_position_enu_m[shown][there])
        canvas.columns(f"{WORLD}/velocity/{name}", at_ns[shown], columns.partition(there.astype(int)))
        style = rr.Arrows3D.from_fields(radii=[ARROW_RADIUS_M], colors=[rgba(color)])
        canvas.style(f"{WORLD}/velocity/{name}", style)
