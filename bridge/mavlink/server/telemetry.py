"""Messages that every vehicle sends, each built from a snapshot, and the schedule of their streams."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import (
    euler_from_quaternion,
    frd_from_flu,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
    yaw_ned_from_enu,
)
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Battery, Commander
from bridge.mavlink.server.profile import CAPABILITIES, EVERY_TICK, POSITION_SOURCE, PX4_CODES, VERSION

V = TypeVar("V", bound=Commander)


@dataclass(slots=True)
class Snapshot(Generic[V]):
    """State of a vehicle at one time, from which all its telemetry is built."""

    vehicle: V
    # state from the vehicle's estimator: position_enu_m of the centre of mass, velocity_enu_m_s, quaternion
    # (w, x, y, z; FLU in ENU), angular_velocity_flu_rad_s
    estimate: Any
    valid: bool  # whether position and velocity are good enough for control
    now_s: float  # time on the server's clock, which schedules the streams
    boot_s: float  # time on the vehicle's boot clock, s
    epoch_ns: int = 0  # Unix time at which the boot clock was zero, ns

    @property
    def boot_ms(self) -> int:
        return round(self.boot_s * 1000) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        return round(self.boot_s * 1e6)


Builder = Callable[[Snapshot[V]], Message]
# builder and default rate, Hz, by message id, in the order within a datagram; rate None: sent at every tick
# (EVERY_TICK) or only on request
StreamTable = Mapping[int, tuple[Builder[V], float | None]]


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
    """Build HOME_POSITION from a position on earth, 1e-7 degrees."""
    home = s.vehicle.home_enu_m
    q = [1.0, 0.0, 0.0, 0.0]
    return dialect.MAVLink_home_position_message(
        latitude_e7, longitude_e7, round(1000 * home[2]), *ned_from_enu(home), q, 0.0, 0.0, 0.0, s.boot_us
    )


def heading_deg(s: Snapshot[V]) -> float:
    """Return the heading clockwise from north, 0 to 360 degrees."""
    return math.degrees(yaw_ned_from_enu(yaw_from_quaternion(s.estimate.quaternion))) % 360.0


def vfr_hud(s: Snapshot[V], throttle_percent: int) -> Message:
    vx, vy, vz = s.estimate.velocity_enu_m_s
    speed, height, heading = math.hypot(vx, vy), s.estimate.position_enu_m[2], round(heading_deg(s)) % 360
    return dialect.MAVLink_vfr_hud_message(speed, speed, heading, throttle_percent, height, vz)


def sys_status(s: Snapshot[V]) -> Message:
    vehicle, present = s.vehicle, s.vehicle.sensors | POSITION_SOURCE
    health = vehicle.sensors | vehicle.sensors_healthy(s.now_s)
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
        CAPABILITIES, VERSION, 0, 0, 0, list(s.vehicle.mark), zeros, zeros, 0, 0, 0
    )


def _millivolts(battery: Battery) -> int:
    return min(max(round(1000 * battery.voltage_v), 0), 0xFFFE)


_OFF = float("inf")
_INTERVAL_MAX_S = 2000.0  # maximum interval, s; MESSAGE_INTERVAL counts microseconds in 32 bits, up to 2147 s


@dataclass(slots=True)
class _Stream(Generic[V]):
    message_id: int
    build: Builder[V]
    default_s: float  # default period of the stream, s; infinite: off
    interval_s: float  # present period, s
    due_s: float
    passed_s: float = -_OFF  # time when the message was last sent, s; it is sent at most once per tick

    def passes(self, now_s: float, limit_s: float) -> bool:
        """Whether the message is due until ``limit_s``; if so, the due time becomes one interval later."""
        if self.due_s > limit_s or now_s == self.passed_s:
            return False
        self.passed_s = now_s
        self.due_s += self.interval_s
        if self.due_s <= now_s:  # missed messages are skipped
            self.due_s = now_s + self.interval_s
        return True


class Streams(Generic[V]):
    """Intervals and due times of all messages; all peers share them, as on a PX4 port."""

    def __init__(self, rate_hz: float, table: StreamTable[V]) -> None:
        """Set the default rates; no request raises a rate above ``rate_hz``."""
        self._period_s = period_s = 1.0 / rate_hz
        self._hidden: frozenset[int] = frozenset()
        self._streams: dict[int, _Stream[V]] = {}
        for id_ in dict.fromkeys((*EVERY_TICK, *table)):
            build, hz = table[id_]
            rate_s = _OFF if hz is None else max(period_s, 1.0 / hz)
            default_s = period_s if id_ in EVERY_TICK else rate_s
            self._streams[id_] = _Stream(id_, build, default_s, default_s, 0.0 if default_s < _OFF else _OFF)
        self._busy: list[_Stream[V]] = []  # streams that are sent at every tick
        self._lazy: list[_Stream[V]] = []  # streams with longer intervals
        self._lazy_due_s = 0.0  # earliest due time of the streams in ``_lazy``
        self._sort()

    def known(self, message_id: int) -> bool:
        return message_id in self._streams

    def interval_us(self, message_id: int) -> int:
        """Return the interval of a message as in MESSAGE_INTERVAL: microseconds, or -1 for off."""
        interval_s = self._streams[message_id].interval_s
        return -1 if interval_s == _OFF else round(interval_s * 1e6)

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> None:
        """Set the interval of a message: microseconds, 0 for the default, negative for off."""
        interval_s = self._interval_s(message_id, interval_us)
        stream = self._streams[message_id]
        if interval_s != stream.interval_s:
            stream.interval_s = interval_s
            stream.due_s = now_s if interval_s < _OFF else _OFF
            self._sort()

    def rarer(self, message_id: int | None, interval_us: float) -> bool:
        stream = self._streams.get(message_id) if message_id is not None else None
        return stream is not None and self._interval_s(stream.message_id, interval_us) > stream.interval_s

    def _interval_s(self, message_id: int, interval_us: float) -> float:
        if interval_us < 0.0:
            return _OFF
        if interval_us == 0.0:
            return self._streams[message_id].default_s
        return min(max(self._period_s, interval_us * 1e-6), _INTERVAL_MAX_S)

    def reset(self, now_s: float) -> None:
        for message_id in self._streams:
            self.set_interval(message_id, 0.0, now_s)

    def hide(self, message_ids: frozenset[int]) -> None:
        """Stop these messages from now on; send all other messages at their rates."""
        if message_ids != self._hidden:
            self._hidden = message_ids
            self._sort()

    def hasten(self, message_id: int) -> None:
        """Make a message due immediately, unless its stream is off."""
        stream = self._streams[message_id]
        if stream.interval_s < _OFF:
            stream.due_s = self._lazy_due_s = 0.0
            stream.passed_s = -_OFF

    def due(self, snapshot: Snapshot[V]) -> list[Message]:
        messages = [stream.build(snapshot) for stream in self._busy]
        return messages + [stream.build(snapshot) for stream in self._passed(snapshot.now_s)]

    def next_s(self, message_ids: frozenset[int]) -> float:
        """Return a lower bound, s, of the due times of these messages, except messages of every tick.

        The bound is -inf unless position and attitude are sent at every tick, and no other of these messages.
        """
        if not self._busy_ids.issuperset(EVERY_TICK) or (self._busy_ids & message_ids).difference(EVERY_TICK):
            return -_OFF
        due_s = [
            stream.due_s
            for id_, stream in self._streams.items()
            if stream.interval_s > self._period_s and id_ in message_ids
        ]
        return min(due_s, default=_OFF) - 0.5 * self._period_s

    def pass_over(self, snapshot: Snapshot[V], message_ids: frozenset[int]) -> list[Message]:
        """Advance as ``due`` does, but build only these messages, and no message of every tick."""
        passed = self._passed(snapshot.now_s)
        return [stream.build(snapshot) for stream in passed if stream.message_id in message_ids]

    def _passed(self, now_s: float) -> list[_Stream[V]]:
        """Return the due streams with longer intervals than a tick; schedule them one interval later."""
        limit_s = now_s + 0.5 * self._period_s  # streams are sent at the tick nearest to their due time
        if self._lazy_due_s > limit_s:
            return []
        passed = [stream for stream in self._lazy if stream.passes(now_s, limit_s)]
        self._lazy_due_s = min((stream.due_s for stream in self._lazy), default=_OFF)
        return passed

    def skip(self, ticks_s: Sequence[float]) -> list[int]:
        """Advance as ``due`` does at each of these times; return the ids of the messages not built."""
        half_s = 0.5 * self._period_s
        skipped = []
        for now_s in ticks_s:
            if self._lazy_due_s <= now_s + half_s:
                skipped += [stream.message_id for stream in self._passed(now_s)]
        return skipped

    def _sort(self) -> None:
        streams = [stream for id_, stream in self._streams.items() if id_ not in self._hidden]
        self._busy = [stream for stream in streams if stream.interval_s <= self._period_s]
        self._busy_ids = {stream.message_id for stream in self._busy}
        self._lazy = [stream for stream in streams if stream.interval_s > self._period_s]
        self._lazy_due_s = 0.0
