"""A vehicle of twenty lines for the autopilot's tests: velocity follows the set-point with a lag."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

NAN = math.nan
FEET_M = 0.0144


@dataclass
class FakeEstimate:
    position_enu_m: tuple[float, float, float] = (0.0, 0.0, FEET_M)
    velocity_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    angular_velocity_flu_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    valid: bool = True


@dataclass
class FakeVehicle:
    battery_v: float = 4.0
    armed: bool = False
    locked: bool = False
    on_pad: bool = False
    on_ground: bool = True
    arm_refusal: str | None = None
    state: FakeEstimate = field(default_factory=FakeEstimate)
    setpoint: tuple[float, float, float] | None = None
    yaw_rad: float = 0.0
    setpoints: int = 0
    stops: int = 0

    @property
    def landed(self) -> bool:
        return self.on_pad or self.on_ground

    def arm(self) -> str | None:
        self.armed = self.arm_refusal is None
        return self.arm_refusal

    def disarm(self, force: bool) -> str | None:
        if not force and not self.landed:
            return "in the air"
        self.armed, self.setpoint = False, None
        return None

    def set_velocity(self, velocity_enu_m_s: tuple[float, float, float], yaw_rad: float) -> None:
        assert all(map(math.isfinite, (*velocity_enu_m_s, yaw_rad)))
        self.setpoint, self.yaw_rad = velocity_enu_m_s, yaw_rad
        self.setpoints += 1

    def stop_setpoint(self) -> None:
        self.setpoint = None
        self.stops += 1

    def estimate(self) -> FakeEstimate:
        return self.state

    def advance(self, dt_s: float) -> None:
        wanted = self.setpoint if self.armed and self.setpoint is not None else (0.0, 0.0, -3.0)
        share = dt_s / 0.1
        velocity = [v + share * (w - v) for v, w in zip(self.state.velocity_enu_m_s, wanted, strict=True)]
        x, y, z = (p + v * dt_s for p, v in zip(self.state.position_enu_m, velocity, strict=True))
        self.on_ground = z <= FEET_M
        if self.on_ground:
            z, velocity = FEET_M, [0.0, 0.0, 0.0]
        self.state.position_enu_m = (x, y, z)
        self.state.velocity_enu_m_s = (velocity[0], velocity[1], velocity[2])
