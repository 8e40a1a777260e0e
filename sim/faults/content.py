"""Faults of what messages say: heartbeat, set-points, time stamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.faults.samples import nth, paused
from sim.faults.schedule import Running
from sim.plant.sensors import NS
from sim.scenarios.fault_table import Kind, What

HELD_BACK_NS = 30_000_000  # of a reordered message: three ticks at 100 Hz

Due = list[int]  # when a message arrives, ns; none: never, two: twice


class Delivery:
    """One running fault that drops, delays or doubles messages."""

    def __init__(self, running: Running) -> None:
        self._running = running
        self._count = 0
        self._burst = True  # turns at the first look: it begins with a good time
        self._change_ns = running.start_ns
        self.apply: Callable[[Due, int], Due] = {
            Kind.OFF: self._off,
            Kind.LOSS: self._loss,
            Kind.BURST_LOSS: self._burst_loss,
            Kind.SLOW: self._slow,
            Kind.INTERMITTENT: self._intermittent,
            Kind.DELAYED: self._delayed,
            Kind.REORDER: self._reorder,
            Kind.DUPLICATE: self._duplicate,
        }[running.fault.kind]

    def _off(self, due: Due, now_ns: int) -> Due:
        del due, now_ns
        return []

    def _happens(self) -> bool:
        return bool(self._running.rng.random() < self._running.fault.amount)

    def _loss(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return [] if self._happens() else due

    def _burst_loss(self, due: Due, now_ns: int) -> Due:
        fault = self._running.fault
        while now_ns >= self._change_ns:
            self._burst = not self._burst
            mean_s = fault.amount if self._burst else fault.period
            self._change_ns += max(1, round(self._running.rng.exponential(mean_s) * NS))
        return [] if self._burst else due

    def _slow(self, due: Due, now_ns: int) -> Due:
        del now_ns
        self._count += 1
        return due if nth(self._running, self._count - 1) else []

    def _intermittent(self, due: Due, now_ns: int) -> Due:
        return [] if paused(self._running, now_ns) else due

    def _delayed(self, due: Due, now_ns: int) -> Due:
        del now_ns
        delay_ns = round(self._running.fault.amount * NS)
        return [at_ns + delay_ns for at_ns in due]

    def _reorder(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return [at_ns + HELD_BACK_NS for at_ns in due] if self._happens() else due

    def _duplicate(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return due + due if self._happens() else due


Rewrite = Callable[[Any, int], None]  # changes a message in place; time in ns

_TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
_SERVO: int = dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW  # the one with 32 bits of microseconds
_HEARTBEAT_FIELDS = ("base_mode", "custom_mode", "system_status")
_VELOCITY_FIELDS = ("vx", "vy", "vz")
_MODE_BITS, _STATES = 1 << 26, 9  # PX4's modes end in bit 26; MAV_STATE has nine
_U32, _U64 = 1 << 32, 1 << 64


class _Frozen:
    """Every message says what the first one said."""

    def __init__(self, fields: tuple[str, ...]) -> None:
        self._fields = fields
        self._first: tuple[Any, ...] | None = None

    def __call__(self, message: Any, now_ns: int) -> None:
        del now_ns
        if self._first is None:
            self._first = tuple(getattr(message, name) for name in self._fields)
        for name, value in zip(self._fields, self._first, strict=True):
            setattr(message, name, value)


def _heartbeat_wrong(running: Running) -> Rewrite:
    del running

    def rewrite(message: Any, now_ns: int) -> None:
        del now_ns
        message.base_mode ^= dialect.MAV_MODE_FLAG_SAFETY_ARMED

    return rewrite


def _heartbeat_garbage(running: Running) -> Rewrite:
    def rewrite(message: Any, now_ns: int) -> None:
        del now_ns
        base, custom, state = running.rng.integers((256, _MODE_BITS, _STATES)).tolist()
        message.base_mode, message.custom_mode, message.system_status = base, custom, state

    return rewrite


def _setpoint_wrong(running: Running) -> Rewrite:
    def rewrite(message: Any, now_ns: int) -> None:
        del now_ns
        for name in _VELOCITY_FIELDS:
            setattr(message, name, getattr(message, name) * running.fault.amount)

    return rewrite


def _setpoint_garbage(running: Running) -> Rewrite:
    def rewrite(message: Any, now_ns: int) -> None:
        del now_ns
        drawn = (running.fault.amount * running.rng.uniform(-1.0, 1.0, 3)).tolist()
        message.vx, message.vy, message.vz = drawn

    return rewrite


def _standing_ns(running: Running, now_ns: int) -> int:
    if not paused(running, now_ns):
        return now_ns
    return now_ns - (now_ns - running.start_ns) % round(running.fault.period * NS)


# fault and simulated time to what the clock shows, ns
_CLOCKS: dict[Kind, Callable[[Running, int], int]] = {
    Kind.OFF: lambda _, __: 0,
    Kind.STUCK: lambda running, _: running.start_ns,
    Kind.WRONG: lambda running, now_ns: now_ns + round(running.fault.amount * NS),
    Kind.DELAYED: lambda running, now_ns: now_ns - round(running.fault.amount * NS),
    Kind.SLOW: lambda running, now_ns: (
        running.start_ns + round(running.fault.amount * (now_ns - running.start_ns))
    ),
    Kind.INTERMITTENT: _standing_ns,
    Kind.GARBAGE: lambda running, _: int(running.rng.integers(_U32)) * 1_000_000,
}


def clock_ns(running: Running, now_ns: int) -> int:
    """What a faulty clock shows, ns; never negative."""
    return max(0, _CLOCKS[running.fault.kind](running, now_ns))


def _clock(running: Running) -> Rewrite:
    def rewrite(message: Any, now_ns: int) -> None:
        if message.get_msgId() == _TIMESYNC:
            if message.tc1 != 0:  # an answer; a request is ours to make in lockstep only
                message.tc1 = max(1, clock_ns(running, now_ns))
            return
        boot_ms = getattr(message, "time_boot_ms", None)
        boot_us = getattr(message, "time_usec", None)
        unix_us = getattr(message, "time_unix_usec", None)
        if boot_ms is None and boot_us is None:
            return
        shown_ns = clock_ns(running, now_ns)
        if boot_ms is not None:
            message.time_boot_ms = shown_ns // 1_000_000 % _U32
        if boot_us is not None:
            size = _U32 if message.get_msgId() == _SERVO else _U64
            message.time_usec = shown_ns // 1000 % size
        if unix_us is not None:
            message.time_unix_usec = max(0, unix_us + (shown_ns - now_ns) // 1000)

    return rewrite


REWRITES: dict[tuple[What, Kind], Callable[[Running], Rewrite]] = {
    (What.HEARTBEAT, Kind.STUCK): lambda _: _Frozen(_HEARTBEAT_FIELDS),
    (What.HEARTBEAT, Kind.WRONG): _heartbeat_wrong,
    (What.HEARTBEAT, Kind.GARBAGE): _heartbeat_garbage,
    (What.SETPOINTS, Kind.STUCK): lambda _: _Frozen(_VELOCITY_FIELDS),
    (What.SETPOINTS, Kind.WRONG): _setpoint_wrong,
    (What.SETPOINTS, Kind.GARBAGE): _setpoint_garbage,
    **{(What.CLOCK, kind): _clock for kind in _CLOCKS},
}
