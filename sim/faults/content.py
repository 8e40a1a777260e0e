"""Faults of message contents: heartbeat, set-points, time stamps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from sim.faults.schedule import Running
from sim.plant.sensors import NS
from sim.scenarios.fault_spec import Kind, What

Rewrite = Callable[[Any, int], None]  # changes a message in place; time in ns
_By = Callable[[Running, Any, int], None]  # the same for a running fault

_TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
_SERVO: int = dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW  # the message with a 32-bit time in microseconds
_HEARTBEAT_FIELDS = ("base_mode", "custom_mode", "system_status")
_VELOCITY_FIELDS = ("vx", "vy", "vz")
_MODE_BITS, _STATES = 1 << 26, 9  # PX4's modes end in bit 26; MAV_STATE has nine
_U32, _U64 = 1 << 32, 1 << 64


def _write(message: Any, fields: tuple[str, ...], values: list[Any]) -> None:
    for name, value in zip(fields, values, strict=True):
        setattr(message, name, value)


def _frozen(fields: tuple[str, ...]) -> Rewrite:
    first: list[Any] = []

    def rewrite(message: Any, now_ns: int) -> None:
        del now_ns
        if not first:
            first[:] = [getattr(message, name) for name in fields]
        _write(message, fields, first)

    return rewrite


def _heartbeat_wrong(_: Running, message: Any, __: int) -> None:
    message.base_mode ^= dialect.MAV_MODE_FLAG_SAFETY_ARMED


def _heartbeat_garbage(running: Running, message: Any, _: int) -> None:
    _write(message, _HEARTBEAT_FIELDS, running.rng.integers((256, _MODE_BITS, _STATES)).tolist())


def _setpoint_wrong(running: Running, message: Any, _: int) -> None:
    scaled = [getattr(message, name) * running.fault.amount for name in _VELOCITY_FIELDS]
    _write(message, _VELOCITY_FIELDS, scaled)


def _setpoint_garbage(running: Running, message: Any, _: int) -> None:
    drawn = (running.fault.amount * running.rng.uniform(-1.0, 1.0, 3)).tolist()
    _write(message, _VELOCITY_FIELDS, drawn)


def _standing_ns(running: Running, now_ns: int) -> int:
    if not running.paused(now_ns):
        return now_ns
    return now_ns - (now_ns - running.start_ns) % round(running.fault.period * NS)


# fault and simulated time to the time of the faulty clock, ns
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
    """Time of a faulty clock, ns; never negative."""
    return max(0, _CLOCKS[running.fault.kind](running, now_ns))


def _clock(running: Running, message: Any, now_ns: int) -> None:
    if message.get_msgId() == _TIMESYNC:
        if message.tc1 != 0:  # a reply; requests are sent in lockstep only
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


_STUCK = {What.HEARTBEAT: _HEARTBEAT_FIELDS, What.SETPOINTS: _VELOCITY_FIELDS}
_REWRITES: Mapping[tuple[What, Kind], _By] = {
    (What.HEARTBEAT, Kind.WRONG): _heartbeat_wrong,
    (What.HEARTBEAT, Kind.GARBAGE): _heartbeat_garbage,
    (What.SETPOINTS, Kind.WRONG): _setpoint_wrong,
    (What.SETPOINTS, Kind.GARBAGE): _setpoint_garbage,
    **{(What.CLOCK, kind): _clock for kind in _CLOCKS},
}


def rewrite_of(running: Running) -> Rewrite | None:
    """Effect of a fault on the content of messages; None: no effect."""
    what, kind = running.fault.what, running.fault.kind
    if kind is Kind.STUCK and what in _STUCK:
        return _frozen(_STUCK[what])
    found = _REWRITES.get((what, kind))
    return None if found is None else partial(found, running)
