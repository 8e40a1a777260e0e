"""Decides whether the vehicle can touch anything, by bounds of the shapes, without a collision search.

The vehicle is taken as a ball, the robot as an upright cylinder about the pad's axis, whatever its heading.
"""

from __future__ import annotations

import mujoco
import numpy as np

from sim.compiled.jit import jitted
from sim.compiled.records import F64, Record

MARGIN_M = 1e-3  # beyond rounding


class ReachRecord(Record):
    """Bounds, m, margin included."""

    vehicle: float  # radius about the centre of mass
    robot: float  # radius about the pad's axis
    robot_top: float  # above the pad


@jitted
def apart(reach: ReachRecord, vehicle: F64, deck: F64) -> bool:
    """Return whether vehicle and floor, and vehicle and robot, cannot touch; False for NaN.

    Args:
        reach: bounds.
        vehicle: centre of mass, ENU, m.
        deck: pad centre, ENU, m.
    """
    x, y, z = vehicle[0] - deck[0], vehicle[1] - deck[1], vehicle[2] - deck[2]
    square, beside = x * x + y * y, reach.vehicle + reach.robot
    above = z > reach.vehicle + reach.robot_top and square >= 0.0
    return bool(vehicle[2] > reach.vehicle and (above or square > beside * beside))


def measure_reach(model: mujoco.MjModel, reach: ReachRecord) -> None:
    """Fill in the bounds of a model with the bodies ``vehicle`` and ``robot_body`` and a floor at z = 0."""
    of_vehicle = model.geom_bodyid == model.body("vehicle").id
    of_robot = model.geom_bodyid == model.body("robot_body").id
    margin = MARGIN_M + model.geom_margin.max() + model.geom_gap.max()
    distances = np.linalg.norm(model.geom_pos[of_vehicle], axis=1)
    reach.vehicle = margin + (distances + model.geom_rbound[of_vehicle]).max()
    # boxes about the geoms, which are not turned in their bodies: centre relative to the geom, half sizes
    centre = model.geom_pos[of_robot] + model.geom_aabb[of_robot, :3]
    half = model.geom_aabb[of_robot, 3:]
    reach.robot = margin + np.hypot(*(np.abs(centre) + half)[:, :2].T).max()
    reach.robot_top = margin + (centre + half)[:, 2].max()
