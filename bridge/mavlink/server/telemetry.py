"""Messages that every vehicle sends, each built from a snapshot."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import (
    Quat,
    euler_from_quaternion,
    frd_from_flu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
    yaw_ned_from_enu,
)
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Battery, Commander
from bridge.mavlink.server.profile import (
    CAPABILITIES,
    POSITION_SOURCE,
    PX4_CODES,
    VERSION,
    ServerProfile,
)
from flightstack.core.types import Vec3


class EstimateLike(Protocol):
    """State of the vehicle from its on-board estimator."""

    @property
    def position_enu_m(self) -> Vec3: ...  # position of the centre of mass

    @property
    def velocity_enu_m_s(self) -> Vec3: ...

    @property
    def quaternion(self) -> Quat: ...  # order w, x, y, z; attitude of FLU in ENU

    @property
    def angular_velocity_flu_rad_s(self) -> Vec3: ...


V = TypeVar("V", bound=Commander)


@dataclass(slots=True)
class Snapshot(Generic[V]):
    """State of a vehicle at one time; all its telemetry is built from this."""

    vehicle: V
    profile: ServerProfile
    estimate: EstimateLike
    valid: bool  # position and velocity are good enough for control
    now_s: float  # time base of the stream rates
    boot_s: float  # boot clock of the vehicle
    epoch_ns: int = 0  # Unix time at zero of the boot clock

    @property
    def boot_ms(self) -> int:
        return round(self.boot_s * 1000) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        return round(self.boot_s * 1e6)


Builder = Callable[[Snapshot[V]], Message]


def heartbeat(s: Snapshot[V]) -> Message:
    """Build HEARTBEAT with PX4's modes and states (PX4 streams/HEARTBEAT.hpp)."""
    vehicle = s.vehicle
    code, armed = PX4_CODES[vehicle.mode], vehicle.armed
    if armed:
        state = dialect.MAV_STATE_CRITICAL if vehicle.failsafe else dialect.MAV_STATE_ACTIVE
    else:
        state = dialect.MAV_STATE_UNINIT if vehicle.problems(s.now_s) else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4,
        code.base | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0),
        code.custom_mode,
        state,
        3,
    )


def local_position_ned(s: Snapshot[V]) -> Message:
    x, y, z = ned_from_enu(s.estimate.position_enu_m)
    vx, vy, vz = ned_from_enu(s.estimate.velocity_enu_m_s)
    return dialect.MAVLink_local_position_ned_message(s.boot_ms, x, y, z, vx, vy, vz)


def attitude(s: Snapshot[V]) -> Message:
    rates = frd_from_flu(s.estimate.angular_velocity_flu_rad_s)
    euler = euler_from_quaternion(ned_frd_from_enu_flu(s.estimate.quaternion))
    return dialect.MAVLink_attitude_message(s.boot_ms, *euler, *rates)


def attitude_quaternion(s: Snapshot[V]) -> Message:
    rates = frd_from_flu(s.estimate.angular_velocity_flu_rad_s)
    return dialect.MAVLink_attitude_quaternion_message(
        s.boot_ms, *ned_frd_from_enu_flu(s.estimate.quaternion), *rates
    )


def home_position(s: Snapshot[V], latitude_e7: int, longitude_e7: int) -> Message:
    """Build HOME_POSITION for a place on earth, 1e-7 degrees."""
    home = s.vehicle.home_enu_m
    q = [1.0, 0.0, 0.0, 0.0]
    return dialect.MAVLink_home_position_message(
        latitude_e7, longitude_e7, round(1000 * home[2]), *ned_from_enu(home), q, 0.0, 0.0, 0.0, s.boot_us
    )


def heading_deg(s: Snapshot[V]) -> float:
    """Return the heading clockwise from north, 0 to 360."""
    return math.degrees(yaw_ned_from_enu(yaw_from_quaternion(s.estimate.quaternion))) % 360.0


def vfr_hud(s: Snapshot[V], throttle_percent: int) -> Message:
    vx, vy, vz = s.estimate.velocity_enu_m_s
    speed, height, heading = math.hypot(vx, vy), s.estimate.position_enu_m[2], round(heading_deg(s)) % 360
    return dialect.MAVLink_vfr_hud_message(speed, speed, heading, throttle_percent, height, vz)


def sys_status(s: Snapshot[V]) -> Message:
    vehicle, present = s.vehicle, s.profile.sensors | POSITION_SOURCE
    health = s.profile.sensors | vehicle.sensors_healthy(s.now_s)
    ready = 0 if vehicle.problems(s.now_s) else dialect.MAV_SYS_STATUS_PREARM_CHECK
    battery = vehicle.battery
    return dialect.MAVLink_sys_status_message(
        present, present, health | ready, 0, _millivolts(battery), -1, battery.percent, 0, 0, 0, 0, 0, 0
    )


def extended_sys_state(s: Snapshot[V]) -> Message:
    return dialect.MAVLink_extended_sys_state_message(
        dialect.MAV_VTOL_STATE_UNDEFINED, s.vehicle.landed_state
    )


def battery_status(s: Snapshot[V]) -> Message:
    battery = s.vehicle.battery
    voltages = [_millivolts(battery)] + [0xFFFF] * 9  # one cell; 0xFFFF means "no cell"
    unknown = dialect.MAV_BATTERY_FUNCTION_UNKNOWN
    return dialect.MAVLink_battery_status_message(
        0, unknown, dialect.MAV_BATTERY_TYPE_LIPO, 0x7FFF, voltages, -1, -1, -1, battery.percent, 0,
        dialect.MAV_BATTERY_CHARGE_STATE_UNDEFINED,
    )  # fmt: skip


def autopilot_version(s: Snapshot[V]) -> Message:
    zeros = [0] * 8
    return dialect.MAVLink_autopilot_version_message(
        CAPABILITIES, VERSION, 0, 0, 0, list(s.profile.mark), zeros, zeros, 0, 0, 0
    )


def _millivolts(battery: Battery) -> int:
    return min(max(round(1000 * battery.voltage_v), 0), 0xFFFE)
