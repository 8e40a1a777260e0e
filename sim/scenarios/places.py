"""Places of vehicles and pads at time zero, ENU, m, and the distance that pads keep from each other."""

from __future__ import annotations

import math

from flightstack.common.strict_toml import ConfigError
from flightstack.core.types import Vec3
from sim.scenarios.tables import PathKind, Start, StartKind, TargetSpec

_PARALLEL = 1e-9  # sine of the angle below which two lines count as parallel
# line on which a pad moves: point on the floor, and direction; direction (0, 0): the pad does not move
Line = tuple[tuple[float, float], tuple[float, float]]


def pad_m(target: TargetSpec, where: str) -> Vec3:
    """Return the centre of a robot's pad at time zero, without heave; ``where``: start of an error text.

    Raises ConfigError: the place is drawn from the seed.
    """
    (x, y), behind_m = target.position_m, target.pad_behind_axle_m
    if behind_m and target.random_heading:
        raise ConfigError(
            f"{where}: target.random_heading: found true, with a pad behind the axle its place is drawn by "
            'chance; give target.heading_rad, or assignment = "fixed"'
        )
    c, s = math.cos(target.heading_rad), math.sin(target.heading_rad)
    return (x - behind_m * c, y - behind_m * s, target.pad_height_m)


def start_m(start: Start, pad: Vec3, where: str) -> Vec3:
    """Return the start position of a vehicle whose pad is at ``pad``; ``where``: start of an error text.

    Raises ConfigError: the place is drawn from the seed.
    """
    if start.kind is StartKind.GROUND:
        return (*start.ground_position_m, 0.0)
    if start.offset_m is None:
        raise ConfigError(
            f"{where}: start.offset_m: missing; its start is drawn by chance, after robots are "
            'assigned: give it, or assignment = "fixed"'
        )
    (x, y, z), (dx, dy, dz) = pad, start.offset_m
    return (x + dx, y + dy, z + dz)


def line(target: TargetSpec) -> Line | None:
    """Return the line on which a robot's pad moves; None: the pad may be anywhere."""
    stands = target.path is PathKind.STILL or target.speed_m_s == 0.0 == target.turn_rate_rad_s
    behind = bool(target.pad_behind_axle_m)
    if (target.random_heading and (behind or not stands)) or (target.turn_rate_rad_s and not stands):
        return None
    x, y, _ = pad_m(target, "")
    return (x, y), (0.0, 0.0) if stands else (math.cos(target.heading_rad), math.sin(target.heading_rad))


def apart_m(one: Line | None, other: Line | None) -> float:
    """Return the smallest distance of two lines or points; 0 if one of them is unknown."""
    if one is None or other is None:
        return 0.0
    (ax, ay), (ux, uy), (bx, by), (vx, vy) = *one, *other
    if abs(ux * vy - uy * vx) > _PARALLEL:
        return 0.0
    x, y = bx - ax, by - ay
    cx, cy = (ux, uy) if (ux, uy) != (0.0, 0.0) else (vx, vy)
    return abs(x * cy - y * cx) if (cx, cy) != (0.0, 0.0) else math.hypot(x, y)
