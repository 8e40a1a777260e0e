"""Markers for 3-D viewers: boundary h = 0, pad, both paths, nominal and filtered velocity."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from itertools import chain
from typing import NamedTuple

from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Vec3
from logs.reader.flight_data import Sizes
from logs.schema.rows import ControllerStepRow

ARROW, CUBE, SPHERE, CYLINDER, LINE_STRIP, TRIANGLE_LIST = 0, 1, 2, 3, 4, 11  # visualization_msgs/msg/Marker
LIFETIME_S = 0.5  # lifetime of a marker without a new message, s: 2.5 periods of 5 Hz
PATH_POINTS = 200  # maximum number of points of a path; a full path loses every second point
PATH_PERIOD_NS = 100_000_000  # initial period of path points, 10 Hz
REACH = 2.5  # drawn radius of the boundary h = 0, divided by the distance of its peak from the axis
REACH_BESIDE = 1.0  # ``REACH`` in a fleet: smaller, so that boundaries of neighbours do not overlap
SECTORS, RINGS = 24, 8  # grid of the boundary: 24 x 8 x 2 triangles
_GRID_1_M = 1024.0  # surface points are rounded to 1/1024 m: finer than a millimetre, and compressible
_ARROW_SIZE_M = (0.012, 0.03, 0.04)  # size of an arrow, m: shaft diameter, head diameter, head length
BODY_SIZE_M = (0.092, 0.092, 0.029)  # Bitcraze, Crazyflie 2.1 data sheet: 92 x 92 x 29 mm
_ARROW_S = 1.0  # arrow length divided by velocity, s

Color = tuple[float, float, float, float]  # fields: red, green, blue, opacity
BARRIER_COLOR: Color = (0.84, 0.15, 0.16, 0.35)
PAD_COLOR: Color = (0.25, 0.25, 0.25, 0.9)
OWN_COLOR: Color = (0.12, 0.47, 0.71, 1.0)
ELLIPSOID_COLOR: Color = (0.12, 0.47, 0.71, 0.15)
TARGET_COLOR: Color = (0.55, 0.34, 0.29, 1.0)
NOMINAL_COLOR: Color = (1.0, 0.5, 0.05, 1.0)
FILTERED_COLOR: Color = (0.17, 0.63, 0.17, 1.0)
COMMAND_COLOR: Color = (0.58, 0.40, 0.74, 1.0)

# Colours of the members of a fleet; a member has the same colour in report and viewer.
# Okabe and Ito (2008), dark colours first, then two of Paul Tol's palettes; member 9 has colour 1 again.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#44AA99")

_NO_ROTATION = (0.0, 0.0, 0.0, 1.0)
_ADD = 0  # value of Marker.action: add or modify a marker
_LIFETIME_NS = round(LIFETIME_S * 1e9)
# colors, texture_resource, texture (header, format, data), uv_coordinates, text, mesh_resource, mesh_file
# (name, data), mesh_use_embedded_materials
_NO_COLORS_TEXTURE_AND_MESH = (b"", "", ((0, ""), "", b""), b"", "", "", ("", b""), False)
_NO_VELOCITY: Vec3 = (math.nan, math.nan, math.nan)


class Marker(NamedTuple):
    frame_id: str
    ns: str
    number: int
    kind: int
    scale: Vec3
    color: Color
    points: bytes = b""  # coordinates of the points, three doubles each
    position: Vec3 = (0.0, 0.0, 0.0)


class Path:
    """Path with a limited number of points; the spacing of the points increases with the path's length."""

    def __init__(self) -> None:
        self.points: list[Vec3] = []
        self._period_ns = PATH_PERIOD_NS
        self._slot: int | None = None

    def add(self, log_time_ns: int, point_m: Vec3) -> None:
        slot = log_time_ns // self._period_ns
        if slot == self._slot:
            return
        self._slot = slot
        self.points.append(point_m)
        if len(self.points) >= PATH_POINTS:
            del self.points[1::2]
            self._period_ns *= 2
            self._slot = log_time_ns // self._period_ns

    def marker(self, number: int, color: Color) -> Marker | None:
        """Return the path as a line marker; None if it has fewer than two points."""
        if len(self.points) < 2:
            return None
        points = struct.pack(f"<{3 * len(self.points)}d", *chain.from_iterable(self.points))
        return Marker("map", "path", number, LINE_STRIP, (0.008, 0.0, 0.0), color, points)


def shapes(own_frame: str, target_frame: str, sizes: Sizes) -> list[Marker]:
    """Return boundary and pad in frames of the target, body and ellipsoid in the frame of the vehicle."""
    radius_m, thickness_m = sizes.pad_radius_m, 0.01
    pad = Marker(
        target_frame, "pad", 0, CYLINDER, (2.0 * radius_m, 2.0 * radius_m, thickness_m), PAD_COLOR,
        position=(0.0, 0.0, -0.5 * thickness_m),  # the origin of the frame is at the top of the pad
    )  # fmt: skip
    found = [pad, Marker(own_frame, "vehicle", 0, CUBE, BODY_SIZE_M, OWN_COLOR)]
    if sizes.barrier is not None:
        mesh = surface(sizes.barrier, REACH if sizes.ellipsoid_m is None else REACH_BESIDE)
        scale = (1.0, 1.0, 1.0)
        frame = f"{target_frame}_pad"
        found.insert(0, Marker(frame, "barrier", 0, TRIANGLE_LIST, scale, BARRIER_COLOR, mesh))
    if sizes.ellipsoid_m is not None:  # a vehicle has an ellipsoid half as large as that of a pair
        beside_m, above_m = sizes.ellipsoid_m
        scale = (beside_m, beside_m, above_m)
        found.append(Marker(own_frame, "ellipsoid", 0, SPHERE, scale, ELLIPSOID_COLOR))
    return found


def scene(row: ControllerStepRow, drawn: Iterable[Marker], own_frame: str) -> list[Marker]:
    """Return the shapes of the bodies whose states are valid in a step, and arrows of the velocities."""
    valid = [each for each in drawn if (row.own_valid if each.frame_id == own_frame else row.target_valid)]
    arrows = (
        (row.nominal_enu_m_s, NOMINAL_COLOR),
        (row.filtered_enu_m_s, FILTERED_COLOR),
        (row.command_enu_m_s if row.setpoint_sent else _NO_VELOCITY, COMMAND_COLOR),
    )
    return valid + [
        _arrow(number, row.own_position_enu_m, velocity_m_s, color)
        for number, (velocity_m_s, color) in enumerate(arrows)
        # NaN: the filter did not run, or no set-point was sent
        if row.own_valid and math.isfinite(sum(velocity_m_s))
    ]


def surface(barrier: Barrier, reach: float = REACH) -> bytes:
    """Return the boundary h = 0 around the landing spot as triangles, three doubles per point.

    ``reach``: radius of the surface, divided by the distance of the peak from the axis. At ``REACH`` the
    height is 56 % of the peak; a larger surface would hide the flight. A fleet's surfaces end at the peak.
    """
    reach_m = reach * barrier.peak_distance_m

    def point(ring: int, sector: int) -> Vec3:
        d_m = reach_m * (ring / RINGS) ** 2  # the rings are closer together near the apex
        angle = 2.0 * math.pi * sector / SECTORS
        height_m = barrier.height(d_m)
        x, y, z = (
            round(v * _GRID_1_M) / _GRID_1_M for v in (d_m * math.cos(angle), d_m * math.sin(angle), height_m)
        )
        return (x, y, z)

    corners: list[float] = []
    for ring in range(RINGS):
        for sector in range(SECTORS):
            a, b = point(ring, sector), point(ring + 1, sector)
            c, d = point(ring + 1, sector + 1), point(ring, sector + 1)
            corners += (*a, *b, *c)
            if ring:  # at the apex both inner corners of a sector coincide
                corners += (*a, *c, *d)
    return struct.pack(f"<{len(corners)}d", *corners)


def values(stamp_ns: int, marker: Marker) -> tuple[object, ...]:
    """Return a marker as values for the packer of its message."""
    return (
        (stamp_ns, marker.frame_id), marker.ns, marker.number, marker.kind, _ADD,
        (marker.position, _NO_ROTATION), marker.scale, marker.color, _LIFETIME_NS,
        True,  # frame_locked: between two messages the viewer moves the marker with its frame
        marker.points, *_NO_COLORS_TEXTURE_AND_MESH,
    )  # fmt: skip


def _arrow(number: int, start_m: Vec3, velocity_m_s: Vec3, color: Color) -> Marker:
    end_m = [p + v * _ARROW_S for p, v in zip(start_m, velocity_m_s, strict=True)]
    points = struct.pack("<6d", *start_m, *end_m)
    return Marker("map", "velocity", number, ARROW, _ARROW_SIZE_M, color, points)
