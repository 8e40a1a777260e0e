"""What the controllers are given: a set-point and the sensed state."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from flightstack.core.types import Vec3
from sim.compiled.records import Axes, Quaternion, Record, Vector


class Setpoint(NamedTuple):
    """A velocity in the world (ENU, m/s) with a yaw; ``stop`` means motors off (firmware: null set-point)."""

    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    yaw_rad: float = 0.0
    stop: bool = False

    def fields(self) -> tuple[float, float, float, float, bool, float, float]:
        """All fields as ``SetpointRecord`` has them."""
        vx, vy, vz, yaw_rad, stop = self
        return (vx, vy, vz, yaw_rad, stop, math.cos(yaw_rad), math.sin(yaw_rad))


STOP = Setpoint(stop=True)


class SetpointRecord(Record):
    """A ``Setpoint`` for compiled code, with the heading's cosine and sine."""

    vx: float
    vy: float
    vz: float
    yaw_rad: float
    stop: bool
    cos_yaw: float
    sin_yaw: float


class SensedState(Record):
    """The estimator's output at 500 Hz; ENU, FLU, SI."""

    position: Vector
    velocity: Vector
    quaternion: Quaternion
    axes: Axes
    rates: Vector  # gyro


class VelocityController(Protocol):
    """A velocity loop with all that is below it, down to counts; called at 500 Hz."""

    def reset(self) -> None:
        """Forget integrals."""

    def update(
        self, sensed: SensedState, setpoint: Setpoint, level: bool
    ) -> tuple[float, tuple[int, int, int]]:
        """Return ``(thrust counts per motor, moment counts about body x, y, z)``."""

    def trim(self, force: Vec3) -> Vec3:
        """Prepare for hover under ``force`` (world, N, nominal scale); return the set-point that holds it."""
