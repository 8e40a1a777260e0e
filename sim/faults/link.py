"""Faults of the MAVLink connection in both directions, and faults of message contents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from sim.faults.samples import LOST
from sim.faults.schedule import Component, Running
from sim.plant.sensors import NS
from sim.scenarios.fault_spec import Kind, What

_TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
_SERVO: int = dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW  # the only message with a 32-bit time in us
_HEARTBEAT_FIELDS = ("base_mode", "custom_mode", "system_status")
_VELOCITY_FIELDS = ("vx", "vy", "vz")
_MODE_BITS, _STATES = 1 << 26, 9  # upper limits of custom_mode and system_status in a damaged heartbeat
_U32, _U64 = 1 << 32, 1 << 64


def _write(message: Any, fields: tuple[str, ...], values: list[Any]) -> None:
    for name, value in zip(fields, values, strict=True):
        setattr(message, name, value)


def _freeze(running: Running, message: Any, fields: tuple[str, ...]) -> None:
    if running.memory is None:
        running.memory = [getattr(message, name) for name in fields]
    _write(message, fields, running.memory)


def _heartbeat_wrong(_: Running, message: Any, __: int) -> None:
    message.base_mode ^= dialect.MAV_MODE_FLAG_SAFETY_ARMED


def _heartbeat_garbage(running: Running, message: Any, _: int) -> None:
    _write(message, _HEARTBEAT_FIELDS, running.rng.integers((256, _MODE_BITS, _STATES)).tolist())


def _setpoint_wrong(running: Running, message: Any, _: int) -> None:
    scaled = [getattr(message, name) * running.fault.amount for name in _VELOCITY_FIELDS]
    _write(message, _VELOCITY_FIELDS, scaled)


def _setpoint_garbage(running: Running, message: Any, _: int) -> None:
    _write(message, _VELOCITY_FIELDS, (running.fault.amount * running.rng.uniform(-1.0, 1.0, 3)).tolist())


def _standing_ns(running: Running, now_ns: int) -> int:
    if not running.paused(now_ns):
        return now_ns
    return now_ns - (now_ns - running.start_ns) % round(running.fault.period * NS)


# function from fault and simulated time (ns) to the faulty time (ns), by kind of clock fault
_CLOCKS: Mapping[Kind, Callable[[Running, int], int]] = {
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
    """Return the time of a faulty clock, ns, not negative."""
    return max(0, _CLOCKS[running.fault.kind](running, now_ns))


def _clock(running: Running, message: Any, now_ns: int) -> None:
    if message.get_msgId() == _TIMESYNC:
        if message.tc1 != 0:  # this message is a reply; only lockstep sends requests
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


# function of fault, message and time (ns) that changes the message in place
_REWRITES: Mapping[tuple[What, Kind], Callable[[Running, Any, int], None]] = {
    (What.HEARTBEAT, Kind.STUCK): lambda running, message, _: _freeze(running, message, _HEARTBEAT_FIELDS),
    (What.SETPOINTS, Kind.STUCK): lambda running, message, _: _freeze(running, message, _VELOCITY_FIELDS),
    (What.HEARTBEAT, Kind.WRONG): _heartbeat_wrong,
    (What.HEARTBEAT, Kind.GARBAGE): _heartbeat_garbage,
    (What.SETPOINTS, Kind.WRONG): _setpoint_wrong,
    (What.SETPOINTS, Kind.GARBAGE): _setpoint_garbage,
    **{(What.CLOCK, kind): _clock for kind in _CLOCKS},
}


class Way(Enum):
    """Direction of a message, seen from the vehicle."""

    IN = "in"
    OUT = "out"


class Fate(NamedTuple):
    """Effect of all active faults on one message."""

    due_ns: tuple[int, ...]  # arrival times, ns; none if lost, two if duplicated
    damaged: bool = False  # whether the checksum is wrong
    stall: Running | None = None  # stall at whose end the message passes; None: no stall


# affected direction and message ids (None: all), by component
CONCERNS: dict[What, tuple[Way, frozenset[int] | None]] = {
    What.LINK_OUT: (Way.OUT, None),
    What.LINK_IN: (Way.IN, None),
    What.HEARTBEAT: (Way.OUT, frozenset({dialect.MAVLINK_MSG_ID_HEARTBEAT})),
    What.SETPOINTS: (Way.IN, frozenset({dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED})),
    What.CLOCK: (Way.OUT, None),
}
HELD_BACK_NS = 30_000_000  # delay of a reordered message, ns: three ticks at 100 Hz

Due = list[int]  # arrival times of a message, ns; none if lost, two if duplicated


def _later(due: Due, by_ns: int) -> Due:
    return [at_ns + by_ns for at_ns in due]


DUE: Mapping[Kind, Callable[[Running, Due], Due]] = {
    Kind.DELAYED: lambda running, due: _later(due, round(running.fault.amount * NS)),
    Kind.REORDER: lambda running, due: _later(due, HELD_BACK_NS) if running.happens() else due,
    Kind.DUPLICATE: lambda running, due: due + due if running.happens() else due,
}


class LinkFaults(Component):
    """Active faults of one vehicle's MAVLink connection; call ``fate`` for every message."""

    def active(self, way: Way) -> bool:
        """Whether messages in this direction need a call of ``fate``."""
        return any(CONCERNS[running.fault.what][0] is way for running in self.running)

    def fate(self, way: Way, message: Message, now_ns: int) -> Fate:
        """Apply all faults to one message, which may be changed; call it once for each message, in order."""
        id_: int = message.get_msgId()
        due, damaged, stall = [now_ns], False, None
        for running in self.running:
            concerned, ids = CONCERNS[running.fault.what]
            kind = running.fault.kind
            if concerned is not way or (ids is not None and id_ not in ids):
                continue
            if rewrite := _REWRITES.get((running.fault.what, kind)):
                rewrite(running, message, now_ns)
            elif kind in LOST:
                due = [] if LOST[kind](running, now_ns) else due
            elif kind in DUE:
                due = DUE[kind](running, due)
            elif kind is Kind.STUCK:
                stall = running
            elif running.happens():  # the only kind left is GARBAGE
                damaged = True
        return Fate(tuple(due), damaged, stall)
