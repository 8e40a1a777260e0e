"""Reads parameters by name (mavlink.io, services/parameter): bounded tries, replies matched by name; pure.

A parameter without reply is missing, with the reason. After a lost reply the number of tries is raised.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message, parameter_name
from bridge.mavlink.profiles import Encoding

_AT_ONCE = 5  # pending requests; the buffer of a radio is small
_PERIOD_S = 0.4  # s between two tries; PX4 and ArduPilot reply within 0.05 s on a wire
_TRIES = 5
_TRIES_LOSSY = 15  # after a lost reply: a busy line of 57,600 baud loses most of them
_FLOAT = struct.Struct("<f")
# Layout of the float field with bytewise integers.
_BYTES: Mapping[int, struct.Struct] = {
    dialect.MAV_PARAM_TYPE_UINT8: struct.Struct("<Bxxx"),
    dialect.MAV_PARAM_TYPE_INT8: struct.Struct("<bxxx"),
    dialect.MAV_PARAM_TYPE_UINT16: struct.Struct("<Hxx"),
    dialect.MAV_PARAM_TYPE_INT16: struct.Struct("<hxx"),
    dialect.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    dialect.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
    dialect.MAV_PARAM_TYPE_REAL32: _FLOAT,
}
_ERRORS = {number: entry.name.removeprefix("MAV_PARAM_ERROR_") for number, entry in
           dialect.enums["MAV_PARAM_ERROR"].items()}  # fmt: skip


class ParameterReader:
    """Requests parameters by name and collects their values."""

    def __init__(
        self, names: Iterable[str], target_system: int, target_component: int, encoding: Encoding
    ) -> None:
        self.values: dict[str, float] = {}  # received values
        self.missing: dict[str, str] = {}  # reasons of the missing ones
        self._open = list(dict.fromkeys(names))
        self._target = (target_system, target_component)
        self._encoding = encoding
        self._tries = dict.fromkeys(self._open, 0)
        self._asked_s = dict.fromkeys(self._open, -math.inf)
        self._tries_max = _TRIES

    @property
    def done(self) -> bool:
        return not self._open

    def take(self, message: Message) -> None:
        """Handle a message of the vehicle; messages without relation to a request are ignored."""
        kind = message.get_msgId()
        if kind == dialect.MAVLINK_MSG_ID_PARAM_VALUE:
            self._value(message)
        elif kind == dialect.MAVLINK_MSG_ID_PARAM_ERROR:
            name = parameter_name(message.param_id)
            if name in self._open:
                self._close(name, f"refused: {_ERRORS.get(message.error, f'error {message.error}')}")

    def step(self, now_s: float) -> list[Message]:
        """Return the requests to send now; a parameter without reply becomes missing."""
        most = self._tries_max
        for name in [n for n in self._open if self._tries[n] >= most and self._waited(n, now_s)]:
            self._close(name, f"no answer to {most} requests in {most * _PERIOD_S:g} s")
        due = [name for name in self._open[:_AT_ONCE] if self._waited(name, now_s)]
        for name in due:
            self._tries[name] += 1
            self._asked_s[name] = now_s
        return [dialect.MAVLink_param_request_read_message(*self._target, name.encode(), -1) for name in due]

    def _waited(self, name: str, now_s: float) -> bool:
        return now_s - self._asked_s[name] >= _PERIOD_S

    def _value(self, message: Message) -> None:
        name = parameter_name(message.param_id)
        if name not in self._open:
            return
        value = self._decoded(message.param_value, message.param_type)
        if value is None or not math.isfinite(value):
            self._close(name, f"not a number: {message.param_value} of type {message.param_type}")
            return
        if self._tries[name] > 1:
            self._tries_max = _TRIES_LOSSY
        self.values[name] = value
        self._open.remove(name)

    def _decoded(self, wire: float, type_: int) -> float | None:
        if self._encoding is Encoding.C_CAST:
            return wire
        struct_ = _BYTES.get(type_)
        return float(struct_.unpack(_FLOAT.pack(wire))[0]) if struct_ is not None else None

    def _close(self, name: str, why: str) -> None:
        self.missing[name] = why
        self._open.remove(name)
