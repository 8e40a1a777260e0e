"""Fakes for tests of the autopilot: a vehicle that follows set-points, and an autopilot with a clock."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.autopilot import Autopilot
from tests.unit.mavlink.server.served import ACCEPTED, COMPANION, NAN, OFFBOARD, Served

FEET_M = 0.0144
RATE_HZ = 100


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
    motor_commands: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    duty: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    trim_velocity_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reboots: int = 0

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

    def reboot(self) -> str | None:
        self.reboots += 1
        self.locked = False
        return None

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


class Rig(Served):
    """An autopilot on a fake vehicle, with simulated time."""

    silence_s = 0.5

    def __init__(self, **vehicle: object) -> None:
        self.vehicle = FakeVehicle(**vehicle)  # type: ignore[arg-type]
        self.server = self.autopilot = Autopilot(self.vehicle, RATE_HZ)
        self.ticks = 0
        self.telemetry: list = []

    @property
    def now_s(self) -> float:
        return self.ticks / RATE_HZ

    @property
    def velocity_enu_m_s(self) -> tuple[float, float, float] | None:
        return self.vehicle.setpoint

    def tick(self) -> None:
        self.telemetry += self.autopilot.telemetry(self.now_s)
        self.autopilot.control(self.now_s)
        self.vehicle.advance(1.0 / RATE_HZ)
        self.ticks += 1

    def texts(self) -> list[str]:
        self.telemetry += self.autopilot.telemetry(self.now_s)
        return [t.text for t in self.autopilot.take_texts()]

    def fly(self, height_m: float = 0.5) -> Rig:
        assert self.command(400, 1.0) == ACCEPTED
        assert self.command(22, *[NAN] * 6, height_m) == ACCEPTED
        self.run(6.0)
        assert self.mode is FlightMode.HOLD
        assert abs(self.vehicle.state.position_enu_m[2] - height_m) < 0.05
        return self

    def homed(self) -> Rig:
        self.autopilot.flight.home_enu_m = (1.0, 2.0, 0.25)
        return self

    def offboard(self) -> Rig:
        self.fly()
        self.run(0.1, (0.0, 0.0, 0.0))
        assert self.command(176, *OFFBOARD) == ACCEPTED
        return self

    def state(self) -> list[object]:
        flight = self.autopilot.flight
        home = [round(v, 4) for v in flight.home_enu_m]
        rest = [home, round(flight.takeoff_z_m, 6), self.vehicle.reboots]
        return [*super().state()[:-1], *rest]


def set_real(rig: Rig, name: str, value: float) -> float:
    message = mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32)
    return rig.handle(message)[-1].param_value


def set_int(rig: Rig, name: str, value: int, sender=COMPANION) -> int:
    wire = struct.unpack("<f", struct.pack("<i", value))[0]
    message = mav.MAVLink_param_set_message(1, 1, name.encode(), wire, mav.MAV_PARAM_TYPE_INT32)
    return struct.unpack("<i", struct.pack("<f", rig.handle(message, sender)[-1].param_value))[0]
