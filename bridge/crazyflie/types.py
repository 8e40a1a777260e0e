"""Data types between the cflib side and the MAVLink side of the Crazyflie bridge.

The Crazyflie's world frame (x, y, z up) is used as ENU; body: FLU. Metres, seconds, radians, volts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntFlag
from typing import Any, NamedTuple

from bridge.frames import Quat
from flightstack.core.types import Vec3

PROTOCOL_MIN = (
    12  # CRTP protocol with arming and emergency stop on the supervisor's port (cflib supervisor.py)
)


class Info(IntFlag):
    """Bits of ``supervisor.info`` (firmware supervisor.c)."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    AUTO_ARM = 1 << 2  # the firmware arms itself, as on every Crazyflie 2.x with brushed motors
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7


class Power(Enum):
    """Values of ``pm.state`` (firmware pm.h)."""

    BATTERY = 0
    CHARGING = 1
    CHARGED = 2
    LOW = 3
    SHUTDOWN = 4


class Velocity(NamedTuple):
    """A velocity set-point: one packet that is sent immediately or dropped."""

    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float  # yaw rate, counter-clockwise


class Pose(NamedTuple):
    position_enu_m: Vec3
    quaternion: Quat  # order w, x, y, z; attitude of FLU in ENU


class Order(Enum):
    STOP = "stop set-point: motors off"
    NOTIFY_STOP = "no more set-points will come"
    ARM = "arm"
    DISARM = "disarm"
    EMERGENCY_STOP = "emergency stop, latched until restart"
    RECOVER = "crash recovery"
    RECONNECT = "close the link and open it again"


class SetParam(NamedTuple):
    name: str
    value: float


Packet = Velocity | Pose | Order | SetParam


class Connected(NamedTuple):
    """The link is open and the start-up requests are answered."""

    protocol: int
    params: dict[str, str]  # values of ``crazyflie_link.PARAMS``; those unknown to the firmware are missing


class Lost(NamedTuple):
    """The link is lost or could not be opened; the next attempt follows."""

    reason: str


class LogPacket(NamedTuple):
    """One packet of a log block, not decoded."""

    block: str  # name in ``state.BLOCKS``
    time_ms: int  # time on the firmware's clock, 24 bits
    values: dict[str, Any]


class ArmReply(NamedTuple):
    accepted: bool
    armed: bool


class ParamValue(NamedTuple):
    name: str
    value: str | None  # value as text; None: the firmware has no such parameter


Event = Connected | Lost | LogPacket | ArmReply | ParamValue


@dataclass(frozen=True, slots=True)
class CrazyflieState:
    """State of one log packet; all values have the same time."""

    at_s: float  # time on the bridge's clock
    boot_ms: int  # time on the firmware's clock, continuous
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: Quat  # order w, x, y, z; attitude of FLU in ENU
    angular_velocity_flu_rad_s: Vec3
    info: Info
    battery_v: float


@dataclass(frozen=True, slots=True)
class Health:
    at_s: float
    variance_m2: Vec3  # variance of the position estimate
    power: Power
    battery_percent: int
    throttle: float = 0.0  # mean of the motors' PWM, 0 to 1


@dataclass(frozen=True, slots=True)
class Outside:
    """Measured gravity, and the firmware's time of the newest external pose."""

    at_s: float
    acceleration_flu_g: Vec3 | None  # specific force measured by the accelerometer
    tick: int | None  # firmware time of the newest external pose, 16 bits, ms


@dataclass(frozen=True, slots=True)
class Link:
    """The firmware of the present connection; ``protocol`` is None without a connection."""

    protocol: int | None = None
    params: dict[str, str] = field(default_factory=dict)
    reason: str = "not connected yet"
