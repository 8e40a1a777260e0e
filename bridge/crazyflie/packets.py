"""Data between bridge and Crazyflie: packets and their queue, events, and decoded log packets.

Urgent packets are sent first; old velocities are dropped. Each packet of the block ``STATE`` has the whole
state in its 26 bytes: ``stateEstimateZ`` (firmware stabilizer.c) in millimetres, millimetres per second, a
quaternion in 32 bits and milliradians per second, then supervisor bits and voltage. Decoded values have
metres, seconds, radians, volts. The Crazyflie's world frame (z up) is used as ENU; the body frame is FLU.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, IntFlag
from types import MappingProxyType
from typing import Any, NamedTuple

from bridge.frames import Quat
from bridge.ros2.cdr import Pose
from flightstack.core.sender_clock import SenderClock
from flightstack.core.types import Vec3


class Velocity(NamedTuple):
    """A velocity set-point; it is sent within 0.1 s or dropped."""

    velocity_enu_m_s: Vec3
    yaw_rate_rad_s: float  # yaw rate, counter-clockwise


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

ORDERS_MAX = 64
VELOCITY_AGE_MAX_S = 0.1  # maximum age of a queued velocity, s; an older velocity is dropped
_URGENT = frozenset({Order.EMERGENCY_STOP, Order.STOP, Order.DISARM})


class Outbox:
    """Thread-safe queue of packets; ``put`` never blocks."""

    def __init__(self) -> None:
        self._ready = threading.Condition()
        self._orders: list[Order | SetParam] = []
        self._newest: dict[type, tuple[Velocity | Pose, float]] = {}  # newest packet of each type, time in s
        self._woken = False

    def put(self, packet: Packet, now_s: float) -> None:
        """Add a packet; an urgent order deletes the queued velocity and always has room."""
        with self._ready:
            if isinstance(packet, Velocity | Pose):
                self._newest[type(packet)] = packet, now_s
            elif packet in _URGENT:
                self._newest.pop(Velocity, None)
                del self._orders[ORDERS_MAX - 1 :]
                self._orders.insert(0 if packet is Order.EMERGENCY_STOP else ORDERS_MAX, packet)
            elif len(self._orders) < ORDERS_MAX:
                self._orders.append(packet)
            self._ready.notify()

    def get(self, timeout_s: float, clock: Callable[[], float]) -> Packet | None:
        """Return the next packet; None: no packet arrived within the time-out."""
        with self._ready:
            self._ready.wait_for(lambda: self._woken or self._orders or self._newest, timeout_s)
            self._woken = False
            if self._orders:
                return self._orders.pop(0)
            for kind in (Velocity, Pose):
                packet, since_s = self._newest.pop(kind, (None, 0.0))
                if packet is not None and (kind is Pose or clock() - since_s <= VELOCITY_AGE_MAX_S):
                    return packet
            return None

    def clear(self) -> None:
        with self._ready:
            self._orders.clear()
            self._newest.clear()

    def wake(self) -> None:
        with self._ready:
            self._woken = True
            self._ready.notify()


# oldest CRTP protocol with arming and emergency stop on the supervisor's port (cflib supervisor.py)
PROTOCOL_MIN = 12


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


class Connected(NamedTuple):
    """Event: the link is open, and the firmware has answered the start-up requests."""

    protocol: int
    params: dict[str, str]  # values of ``link.PARAMS``, without parameters unknown to the firmware
    reason: str = ""


class Lost(NamedTuple):
    """Event: the link is lost or could not be opened; the next attempt follows."""

    reason: str
    protocol: None = None
    params: Mapping[str, str] = MappingProxyType({})


class LogPacket(NamedTuple):
    """One packet of a log block, not decoded."""

    block: str  # name in ``BLOCKS``
    time_ms: int  # time on the firmware's clock, ms, 24 bits
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

    at_s: float  # time of measurement on the bridge's clock, s
    boot_ms: int  # time of measurement on the firmware's clock, ms, without wrap-around
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    quaternion: Quat  # attitude of FLU in ENU, in the order w, x, y, z
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


class Block(NamedTuple):
    """A log block: variables that the firmware sends together in one packet."""

    name: str
    period_ms: int
    variables: tuple[str, ...]


_MOTORS = tuple(f"motor.m{number}" for number in (1, 2, 3, 4))
STATE = Block("state", 10, (
    *(f"stateEstimateZ.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "quat")),
    *(f"stateEstimateZ.rate{axis}" for axis in ("Roll", "Pitch", "Yaw")), "supervisor.info", "pm.vbatMV",
))  # fmt: skip
HEALTH = Block(
    "health", 100, (*(f"kalman.varP{axis}" for axis in "XYZ"), "pm.state", "pm.batteryLevel", *_MOTORS)
)
GRAVITY = Block("gravity", 100, ("acc.x", "acc.y", "acc.z"))  # specific force, body axes, g
BLOCKS = (STATE, HEALTH, GRAVITY)
FETCHED_AS: Mapping[str, str] = dict.fromkeys(_MOTORS, "uint16_t")  # requested type; older firmware: 32 bits
_PWM_MAX = 65535.0
LATE_MAX_S = 0.05  # maximum delay of a packet, s; a later packet is ignored
# Time for which packets must agree on a changed clock before this clock is used, s. PATIENCE_S is for late
# packets: they may come from a queue, since the clock of a simulated firmware may stop. Else PROOF_S is used.
PROOF_S, PATIENCE_S = 0.05, 0.3
_WRAP_MS = 1 << 24
_REBOOT_MS = 1000  # difference from the expected time above which the firmware may have restarted, ms
_DRIFT = 0.1  # maximum relative clock drift of a simulated firmware; the clock of CrazySim ran 3 % slow


class BootClock:
    """Converts the firmware's 24-bit time, ms, into a continuous clock, and measures the delay of packets."""

    def __init__(self) -> None:
        self.restarts = 0  # number of restarts of the firmware and backward steps of its clock
        self._last_ms: int | None = None
        self._last_at_s = 0.0
        self.begin()

    def begin(self) -> None:
        """Start again on a new connection; the last time remains stored to detect a restart."""
        self._clock = SenderClock(LATE_MAX_S, PROOF_S)

    @property
    def running(self) -> bool:
        """Whether a packet of this connection has arrived."""
        return self._clock.memory.began_s < math.inf

    def take(self, time_ms: int, at_s: float) -> tuple[int, float] | None:
        """Convert a 24-bit time; return continuous time, ms, and delay, s; None: do not use the packet."""
        last_ms, boot_ms, restarted = self._last_ms, time_ms, False
        if last_ms is not None:
            elapsed_ms = 1000.0 * (at_s - self._last_at_s)
            step_ms = (time_ms - last_ms + _WRAP_MS // 2) % _WRAP_MS - _WRAP_MS // 2
            unexpected = abs(step_ms - elapsed_ms) > _REBOOT_MS + _DRIFT * elapsed_ms
            restarted = unexpected and time_ms <= elapsed_ms + _REBOOT_MS
            if restarted:
                self.begin()
            else:
                boot_ms = last_ms + step_ms
        if not self._clock.accept(boot_ms / 1000.0, at_s, PATIENCE_S).good:
            return None
        self.restarts += restarted or (last_ms is not None and boot_ms < last_ms)
        self._last_ms, self._last_at_s = boot_ms, at_s
        return boot_ms, self._clock.lateness_s(boot_ms / 1000.0, at_s)

    def now_ns(self, now_s: float) -> int:
        """Return the firmware's clock, ns, at a time of the bridge's clock, for TIMESYNC."""
        return max(1, round((now_s - self._clock.memory.offset_s) * 1e9))


def decode_state(v: Mapping[str, int], boot_ms: int, at_s: float) -> CrazyflieState:
    """Decode the variables of ``STATE``; ``boot_ms`` and ``at_s``: as in ``CrazyflieState``."""
    from cflib.utils.encoding import decompress_quaternion  # a late import: the package is an extra

    x, y, z, vx, vy, vz = (v[name] / 1000.0 for name in STATE.variables[:6])
    qx, qy, qz, qw = decompress_quaternion(v["stateEstimateZ.quat"]).tolist()
    roll, pitch, yaw = (v[f"stateEstimateZ.rate{axis}"] / 1000.0 for axis in ("Roll", "Pitch", "Yaw"))
    return CrazyflieState(
        at_s,
        boot_ms,
        (x, y, z),
        (vx, vy, vz),
        (qw, qx, qy, qz),
        (roll, -pitch, yaw),  # the firmware's pitch has the opposite sign (stabilizer.c, compressState)
        Info(v["supervisor.info"] & sum(Info)),
        v["pm.vbatMV"] / 1000.0,
    )


def decode_health(v: Mapping[str, Any], at_s: float) -> Health:
    variance = (v["kalman.varPX"], v["kalman.varPY"], v["kalman.varPZ"])
    throttle = sum(v[name] for name in _MOTORS) / (4.0 * _PWM_MAX)
    return Health(at_s, variance, Power(int(v["pm.state"])), int(v["pm.batteryLevel"]), throttle)
