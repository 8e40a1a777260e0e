"""The three-dimensional part of a Rerun recording: barrier, pad, vehicle, paths and velocities."""

from __future__ import annotations

import numpy as np
import rerun as rr

from flightstack.core.safety.barrier import Barrier
from logs.derive.markers import (
    BARRIER_COLOR,
    BODY_SIZE_M,
    COMMAND_COLOR,
    FILTERED_COLOR,
    FLEET_REACH,
    NOMINAL_COLOR,
    PAD_COLOR,
    PAD_RADIUS_M,
    REACH,
    TARGET_COLOR,
    Color,
    Path,
    surface,
)
from logs.view.canvas import WORLD, Canvas
from logs.view.read import Floats, Seen, column, every, times

SCENE_PERIOD_NS = 20_000_000  # 50 Hz
PATH_PERIOD_NS = 200_000_000  # 5 Hz: each row is a whole path
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


def scene(canvas: Canvas, seen: Seen) -> None:
    """Send what the controller saw: vehicle, target with its pad and barrier, both paths."""
    canvas.style(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    if not seen.steps:
        return
    steps = [seen.steps[i] for i in every(seen.steps, SCENE_PERIOD_NS)]
    at_ns = times(steps)
    for name, valid, position, yaw in (
        ("vehicle", "own_valid", "own_position_enu_m", "own_yaw_rad"),
        ("target", "target_valid", "target_position_enu_m", "target_yaw_rad"),
    ):
        good = column(steps, valid) > 0.0
        position_m, half_rad = column(steps, position)[good], 0.5 * column(steps, yaw)[good]
        nothing = np.zeros_like(half_rad)
        turn = np.stack([nothing, nothing, np.sin(half_rad), np.cos(half_rad)], axis=1)
        moved = rr.Transform3D.columns(translation=position_m, quaternion=turn)
        canvas.columns(f"{WORLD}/{name}", at_ns[good], moved)
        if name == "target":  # the barrier goes with the target but does not turn with it
            canvas.columns(SPOT, at_ns[good], rr.Transform3D.columns(translation=position_m))
    canvas.style(
        f"{WORLD}/vehicle/body",
        rr.Boxes3D(
            half_sizes=[BODY_HALF_M], colors=[rgba(canvas.own_color)], fill_mode="solid",
            labels=[canvas.member] if canvas.member else None,
        ),
    )  # fmt: skip
    if "ellipsoid_xy_m" in seen.run and "ellipsoid_z_m" in seen.run:  # those of two touch at their limit
        beside_m, above_m = 0.5 * float(seen.run["ellipsoid_xy_m"]), 0.5 * float(seen.run["ellipsoid_z_m"])
        canvas.style(
            f"{WORLD}/vehicle/ellipsoid",
            rr.Ellipsoids3D(
                half_sizes=[(beside_m, beside_m, above_m)], colors=[rgba(canvas.own_color)],
                line_radii=[ELLIPSOID_LINE_M], fill_mode="majorwireframe",
            ),
        )  # fmt: skip
    radius_m, thickness_m = float(seen.run.get("pad_radius_m", PAD_RADIUS_M)), 0.01
    canvas.style(
        f"{WORLD}/target/pad",
        rr.Cylinders3D(
            lengths=[thickness_m], radii=[radius_m], centers=[(0.0, 0.0, -0.5 * thickness_m)],
            colors=[rgba(PAD_COLOR)], fill_mode="solid",
        ),
    )  # fmt: skip
    _barrier(canvas, seen)
    _paths(canvas, seen)


def truth(canvas: Canvas, seen: Seen) -> None:
    """Send what the simulator knows, where there was one."""
    if not seen.truths:
        return
    scene = [seen.truths[i] for i in every(seen.truths, SCENE_PERIOD_NS)]
    moved = rr.Transform3D.columns(
        translation=column(scene, "position_enu_m"), quaternion=column(scene, "orientation")
    )
    canvas.columns(f"{WORLD}/true_vehicle", times(scene), moved)
    body = rr.Boxes3D(half_sizes=[BODY_HALF_M], colors=[rgba(TRUE_COLOR)])
    canvas.style(f"{WORLD}/true_vehicle/body", body)


def _barrier(canvas: Canvas, seen: Seen) -> None:
    if "barrier_alpha_1_m" not in seen.run or "barrier_beta_m" not in seen.run:
        return
    barrier = Barrier(float(seen.run["barrier_alpha_1_m"]), float(seen.run["barrier_beta_m"]))
    if barrier.alpha_1_m <= 0.0:
        return
    reach = FLEET_REACH if canvas.member else REACH
    corners = np.frombuffer(surface(barrier, reach), dtype="<f8").reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    mesh = rr.Mesh3D(
        vertex_positions=corners, triangle_indices=triangles, vertex_normals=_normals(corners),
        albedo_factor=rgba(BARRIER_COLOR), face_rendering="DoubleSided",
    )  # fmt: skip
    canvas.style(f"{SPOT}/barrier", mesh)


def _normals(corners: Floats) -> Floats:
    """Unit normals of triangles, one a corner and all upwards: light shows the shape."""
    a, b, c = corners[0::3], corners[1::3], corners[2::3]
    normal = np.cross(b - a, c - a)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal, 3, axis=0)


def _paths(canvas: Canvas, seen: Seen) -> None:
    """Send both paths as they grow."""
    for name, valid, field, color in (
        ("vehicle_path", "own_valid", "own_position_enu_m", canvas.own_color),
        ("target_path", "target_valid", "target_position_enu_m", TARGET_COLOR),
    ):
        path = canvas.paths.setdefault(name, Path())
        strips, at_ns = [], []
        for time_ns, row in seen.steps:
            if getattr(row, valid):
                path.add(time_ns, getattr(row, field))
            if not canvas.due(name, PATH_PERIOD_NS, time_ns):
                continue
            if (marker := path.marker(0, color)) is not None:
                strips.append(np.frombuffer(marker.points, dtype="<f8").reshape(-1, 3))
                at_ns.append(time_ns)
        if strips:
            canvas.columns(
                f"{WORLD}/{name}", np.array(at_ns, dtype=np.int64), rr.LineStrips3D.columns(strips=strips)
            )
            style = rr.LineStrips3D.from_fields(radii=[LINE_RADIUS_M], colors=[rgba(color)])
            canvas.style(f"{WORLD}/{name}", style)


def velocities(canvas: Canvas, seen: Seen) -> None:
    """Send arrows at the vehicle, one metre a metre a second; none where there is no such velocity."""
    steps = [seen.steps[i] for i in every(seen.steps, SCENE_PERIOD_NS)]
    if not steps:
        return
    origin_m = column(steps, "own_position_enu_m")
    for name, field, color in VELOCITIES:
        vector = column(steps, field)
        there = np.isfinite(vector).all(axis=1) & (column(steps, "own_valid") > 0.0)
        if name == "command":
            there &= column(steps, "setpoint_sent") > 0.0
        columns = rr.Arrows3D.columns(vectors=vector[there], origins=origin_m[there])
        canvas.columns(f"{WORLD}/velocity/{name}", times(steps), columns.partition(there.astype(int)))
        style = rr.Arrows3D.from_fields(radii=[ARROW_RADIUS_M], colors=[rgba(color)])
        canvas.style(f"{WORLD}/velocity/{name}", style)


def rgba(color: Color) -> tuple[int, int, int, int]:
    """A color in 0 to 255, as Rerun wants it."""
    red, green, blue, opacity = (round(255 * part) for part in color)
    return red, green, blue, opacity
