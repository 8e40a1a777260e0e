"""The ground robot's motion and its odometry (signatures; body being written)."""

from __future__ import annotations

from dataclasses import dataclass

from flightstack.types import Vec3
from sim.scenario import OdometryLink, TargetSpec


@dataclass(frozen=True, slots=True)
class PadPose:
    """Pose of the pad centre (top surface)."""

    position_enu_m: Vec3
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class TargetMeasurement:
    """One odometry sample; twist in the body frame (x forward, y left)."""

    time_s: float  # of the measurement
    position_enu_m: Vec3
    yaw_rad: float
    velocity_body_m_s: Vec3
    yaw_rate_rad_s: float


class TargetModel:
    """pose, velocity_enu_m_s, yaw_rate_rad_s hold for time_s; the twist holds unchanged until the next step."""

    time_s: float
    pose: PadPose
    velocity_enu_m_s: Vec3
    velocity_body_m_s: Vec3
    yaw_rate_rad_s: float

    def __init__(self, spec: TargetSpec, seed: int, *, step_s: float = 0.01) -> None: ...
    def step(self, dt_s: float, driving: bool) -> None: ...


class TargetOdometry:
    """Call ``step(model)`` at time zero and after every model.step: takes a sample when due, returns those released."""

    def __init__(self, link: OdometryLink, seed: int) -> None: ...
    def step(self, model: TargetModel) -> list[TargetMeasurement]: ...
