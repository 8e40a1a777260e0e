"""Data between the cflib side and the MAVLink side of the Crazyflie bridge.

World is the Crazyflie's own (x, y, z up), taken as ENU; body is FLU. Metres, seconds, radians, volts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntFlag
from typing import NamedTuple

from bridge.frames import Quat
from flightstack.core.types import Vec3

PROTOCOL_MIN = (
    12  # CRTP protocol with arming and emergency stop on the supervisor's port (cflib supervisor.py)
)


class Info(IntFlag):
    """Bits of ``supervisor.info`` (firmware supervisor.c)."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    AUTO_ARM = 1 << 2  # the firmware arms itself, as all Crazyflie 2.x with brushed motors do
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7


class Power(Enum):
    """``pm.state`` (firmware pm.h)."""

    BATTERY = 0
    CHARGING = 1
    CHARGED = 2
    LOW = 3
    SHUTDOWN = 4


class Velocity(NamedTuple):
    """A velocity set-point: one packet, sent at once or never."""

    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float  # counter-clockwise


class Pose(NamedTuple):
    """A pose from outside, for the on-board estimator."""

    position_enu_m: Vec3
    quaternion: Quat  # w, x, y, z, of FLU in ENU


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
    """The link is open, and all requests of its start have been answered."""

    protocol: int
    params: dict[str, str]  # of ``crazyflie_link.PARAMS``; those the firmware does not have are missing


class Lost(NamedTuple):
    """The link is lost or could not be opened; the next attempt follows."""

    reason: str


class StateBlock(NamedTuple):
    """One log packet of the state, unchanged."""

    time_ms: int  # firmware clock, 24 bits
    values: dict[str, int]


class HealthBlock(NamedTuple):
    """One log packet of values that change slowly."""

    values: dict[str, float]


class OutsideBlock(NamedTuple):
    """One log packet for the check of external poses; firmware may lack any of its values."""

    values: dict[str, float]


class ArmReply(NamedTuple):
    """The supervisor's answer to an arming request."""

    accepted: bool
    armed: bool


class ParamValue(NamedTuple):
    name: str
    value: str | None  # None: the firmware has no such parameter


Event = Connected | Lost | StateBlock | HealthBlock | OutsideBlock | ArmReply | ParamValue


class Arrived(NamedTuple):
    """An event with the time of its arrival."""

    at_s: float  # time.monotonic()
    event: Event


@dataclass(frozen=True, slots=True)
class CrazyflieState:
    """State of one log packet, all of one time."""

    at_s: float  # bridge clock
    boot_ms: int  # firmware clock, unwrapped
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: Quat  # w, x, y, z, of FLU in ENU
    angular_velocity_flu_rad_s: Vec3
    info: Info
    battery_v: float


@dataclass(frozen=True, slots=True)
class Health:
    at_s: float
    variance_m2: Vec3  # of the position estimate
    power: Power
    battery_percent: int
    throttle: float = 0.0  # mean of the motors' PWM, 0 to 1


@dataclass(frozen=True, slots=True)
class Outside:
    """Gravity by the accelerometer, and the firmware's time of the newest pose from outside."""

    at_s: float
    acceleration_flu_g: Vec3 | None  # specific force
    tick: int | None  # 16 bits, ms


@dataclass(frozen=True, slots=True)
class Link:
    """The firmware of the present connection; ``protocol`` None: not connected."""

    protocol: int | None = None
    params: dict[str, str] = field(default_factory=dict)
    reason: str = "not connected yet"
