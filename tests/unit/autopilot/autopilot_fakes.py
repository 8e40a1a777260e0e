"""For the autopilot's tests: a small vehicle that follows its set-point, and a rig that flies it."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.autopilot import Autopilot

NAN = math.nan
FEET_M = 0.0144
RATE_HZ = 100
COMPANION = (1, 191)
GROUND_STATION = (255, 190)
OFFBOARD = (1.0, 6.0, 0.0)
HOLD = (1.0, 4.0, 3.0)


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
    reboots: int = 0
    failures: dict[tuple[int, int], int] = field(default_factory=dict)  # (unit, instance) to type
    failure_refusal: str | None = None

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

    def inject_failure(self, unit: int, kind: int, instance: int) -> str | None:
        if self.failure_refusal is None:
            self.failures[unit, instance] = kind
        return self.failure_refusal

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


class Rig:
    """An autopilot on a fake vehicle, with time."""

    def __init__(self, **vehicle: object) -> None:
        self.vehicle = FakeVehicle(**vehicle)  # type: ignore[arg-type]
        self.autopilot = Autopilot(self.vehicle, RATE_HZ)
        self.tick = 0
        self.telemetry: list = []

    @property
    def now_s(self) -> float:
        return self.tick / RATE_HZ

    @property
    def mode(self) -> FlightMode:
        return self.autopilot.flight.mode

    def handle(self, message, sender=COMPANION) -> list:
        return self.autopilot.handle(message, sender, self.now_s)

    def run(self, duration_s: float, velocity_ned=None, sender=COMPANION) -> None:
        for _ in range(round(duration_s * RATE_HZ)):
            self.telemetry += self.autopilot.telemetry(self.now_s)
            if velocity_ned is not None:
                self.handle(setpoint(*velocity_ned), sender)
            self.autopilot.control(self.now_s)
            self.vehicle.advance(1.0 / RATE_HZ)
            self.tick += 1

    def command(self, number: int, *params: float, sender=COMPANION, target=(1, 1)) -> int | None:
        values = [*params, *[NAN] * (7 - len(params))]
        replies = self.handle(mav.MAVLink_command_long_message(*target, number, 0, *values), sender)
        acks = [r for r in replies if r.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_ACK]
        assert all((a.target_system, a.target_component, a.command) == (*sender, number) for a in acks)
        return acks[0].result if acks else None

    def texts(self) -> list[str]:
        self.telemetry += self.autopilot.telemetry(self.now_s)
        return [t.text for t in self.autopilot.take_texts()]

    def fly(self, height_m: float = 0.5) -> Rig:
        assert self.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
        assert self.command(22, *[NAN] * 6, height_m) == mav.MAV_RESULT_ACCEPTED
        self.run(6.0)
        assert self.mode is FlightMode.HOLD
        assert abs(self.vehicle.state.position_enu_m[2] - height_m) < 0.05
        return self

    def offboard(self) -> Rig:
        self.fly()
        self.run(0.1, (0.0, 0.0, 0.0))
        assert self.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
        return self

    def seen(self, message_id: int) -> list:
        return [m for m in self.telemetry if m.get_msgId() == message_id]


def setpoint(n=0.0, e=0.0, d=0.0, *, frame=1, mask=2503, yaw=0.0, rate=0.0, target=(1, 1)):
    zeros = (0.0, 0.0, 0.0)
    return mav.MAVLink_set_position_target_local_ned_message(
        0, *target, frame, mask, *zeros, n, e, d, *zeros, yaw, rate
    )


def set_real(rig: Rig, name: str, value: float) -> float:
    message = mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32)
    return rig.handle(message)[-1].param_value


def set_int(rig: Rig, name: str, value: int, sender=COMPANION) -> int:
    wire = struct.unpack("<f", struct.pack("<i", value))[0]
    message = mav.MAVLink_param_set_message(1, 1, name.encode(), wire, mav.MAV_PARAM_TYPE_INT32)
    return struct.unpack("<i", struct.pack("<f", rig.handle(message, sender)[-1].param_value))[0]
