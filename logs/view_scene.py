"""The three-dimensional part of a Rerun recording: barrier, pad, vehicle, paths and velocities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from flightstack.barrier import Barrier
from logs.derive_markers import (
    BARRIER_COLOR,
    BODY_SIZE_M,
    COMMAND_COLOR,
    FILTERED_COLOR,
    NOMINAL_COLOR,
    OWN_COLOR,
    PAD_COLOR,
    PAD_RADIUS_M,
    TARGET_COLOR,
    Color,
    surface,
)
from logs.derive_markers import Path as BoundedPath
from logs.view_blueprint import FLIGHT, LOG_TIME, WORLD
from logs.view_read import Floats, Ints, Seen, column, every, times

SCENE_PERIOD_NS = 20_000_000  # 50 Hz
PATH_PERIOD_NS = 200_000_000  # 5 Hz: each row is a whole path
BODY_HALF_M = tuple(0.5 * size for size in BODY_SIZE_M)
ARROW_RADIUS_M, LINE_RADIUS_M = 0.006, 0.004
SPOT = f"{WORLD}/target_spot"
FLOWN_COLOR: Color = (0.12, 0.47, 0.71, 1.0)
TRUE_COLOR: Color = (0.5, 0.5, 0.5, 1.0)
VELOCITIES = (
    ("nominal", "nominal_enu_m_s", NOMINAL_COLOR),
    ("filtered", "filtered_enu_m_s", FILTERED_COLOR),
    ("command", "command_enu_m_s", COMMAND_COLOR),
    ("flown", "own_velocity_enu_m_s", FLOWN_COLOR),
)


def scene(stream: rr.RecordingStream, seen: Seen) -> None:
    """Send what the controller saw: vehicle, target with its pad and barrier, both paths."""
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
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
        at = when(seen, at_ns[good])
        moved = rr.Transform3D.columns(translation=position_m, quaternion=turn)
        stream.send_columns(f"{WORLD}/{name}", at, moved)
        if name == "target":  # the barrier goes with the target but does not turn with it
            stream.send_columns(SPOT, at, rr.Transform3D.columns(translation=position_m))
    stream.log(
        f"{WORLD}/vehicle/body",
        rr.Boxes3D(half_sizes=[BODY_HALF_M], colors=[rgba(OWN_COLOR)], fill_mode="solid"),
        static=True,
    )
    radius_m, thickness_m = float(seen.run.get("pad_radius_m", PAD_RADIUS_M)), 0.01
    stream.log(
        f"{WORLD}/target/pad",
        rr.Cylinders3D(
            lengths=[thickness_m], radii=[radius_m], centers=[(0.0, 0.0, -0.5 * thickness_m)],
            colors=[rgba(PAD_COLOR)], fill_mode="solid",
        ),
        static=True,
    )  # fmt: skip
    _barrier(stream, seen)
    _paths(stream, seen)


def truth(stream: rr.RecordingStream, seen: Seen) -> None:
    """Send what the simulator knows, where there was one."""
    if not seen.truths:
        return
    scene = [seen.truths[i] for i in every(seen.truths, SCENE_PERIOD_NS)]
    moved = rr.Transform3D.columns(
        translation=column(scene, "position_enu_m"), quaternion=column(scene, "orientation_xyzw")
    )
    stream.send_columns(f"{WORLD}/true_vehicle", when(seen, times(scene)), moved)
    body = rr.Boxes3D(half_sizes=[BODY_HALF_M], colors=[rgba(TRUE_COLOR)])
    stream.log(f"{WORLD}/true_vehicle/body", body, static=True)


def _barrier(stream: rr.RecordingStream, seen: Seen) -> None:
    if "barrier_alpha_1_m" not in seen.run or "barrier_beta_m" not in seen.run:
        return
    barrier = Barrier(float(seen.run["barrier_alpha_1_m"]), float(seen.run["barrier_beta_m"]))
    if barrier.alpha_1_m <= 0.0:
        return
    corners = np.frombuffer(surface(barrier), dtype="<f8").reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    mesh = rr.Mesh3D(
        vertex_positions=corners, triangle_indices=triangles, vertex_normals=_normals(corners),
        albedo_factor=rgba(BARRIER_COLOR), face_rendering="DoubleSided",
    )  # fmt: skip
    stream.log(f"{SPOT}/barrier", mesh, static=True)


def _normals(corners: Floats) -> Floats:
    """Unit normals of triangles, one a corner and all upwards: light shows the shape."""
    a, b, c = corners[0::3], corners[1::3], corners[2::3]
    normal = np.cross(b - a, c - a)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal, 3, axis=0)


def _paths(stream: rr.RecordingStream, seen: Seen) -> None:
    """Send both paths as they grow."""
    for name, valid, field, color in (
        ("vehicle_path", "own_valid", "own_position_enu_m", OWN_COLOR),
        ("target_path", "target_valid", "target_position_enu_m", TARGET_COLOR),
    ):
        path, strips, at_ns = BoundedPath(), [], []
        due = set(every(seen.steps, PATH_PERIOD_NS))
        for index, (time_ns, row) in enumerate(seen.steps):
            if getattr(row, valid):
                path.add(time_ns, getattr(row, field))
            if index in due and (marker := path.marker(0, color)) is not None:
                strips.append(np.frombuffer(marker.points, dtype="<f8").reshape(-1, 3))
                at_ns.append(time_ns)
        if strips:
            at = when(seen, np.array(at_ns, dtype=np.int64))
            stream.send_columns(f"{WORLD}/{name}", at, rr.LineStrips3D.columns(strips=strips))
            style = rr.LineStrips3D.from_fields(radii=[LINE_RADIUS_M], colors=[rgba(color)])
            stream.log(f"{WORLD}/{name}", style, static=True)


def velocities(stream: rr.RecordingStream, seen: Seen) -> None:
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
        stream.send_columns(
            f"{WORLD}/velocity/{name}", when(seen, times(steps)), columns.partition(there.astype(int))
        )
        style = rr.Arrows3D.from_fields(radii=[ARROW_RADIUS_M], colors=[rgba(color)])
        stream.log(f"{WORLD}/velocity/{name}", style, static=True)


def when(seen: Seen, at_ns: Ints) -> Sequence[rr.TimeColumn]:
    """Log times in ns on both timelines."""
    return (
        rr.TimeColumn(FLIGHT, duration=(at_ns - seen.origin_ns).astype("timedelta64[ns]")),
        rr.TimeColumn(LOG_TIME, timestamp=at_ns.astype("datetime64[ns]")),
    )


def rgba(color: Color) -> tuple[int, int, int, int]:
    """A color in 0 to 255, as Rerun wants it."""
    red, green, blue, opacity = (round(255 * part) for part in color)
    return red, green, blue, opacity
