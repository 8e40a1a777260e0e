"""Parameters of a vehicle: read, listed and written by MAVLink's parameter protocol."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.server.commander import Sender

INT32 = dialect.MAV_PARAM_TYPE_INT32
REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_FLOAT = struct.Struct("<f")
_INT = struct.Struct("<i")
_LIST_AT_ONCE = 20  # number of PARAM_VALUE messages of a requested list per tick, as PX4 sends over UDP
_UNKNOWN: int = dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
_OUT_OF_RANGE: int = dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
_READ_ONLY: int = dialect.MAV_PARAM_ERROR_READ_ONLY
_NOT_NOW: int = dialect.MAV_PARAM_ERROR_PERMISSION_DENIED


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: default, allowed range (including both ends), and whether it may change in flight."""

    name: str  # name of at most 16 characters
    type: int  # type number of MAVLink (MAV_PARAM_TYPE); PX4 has only INT32 and REAL32
    default: float
    low: float
    high: float
    in_flight: bool = False
    choices: tuple[int, ...] = ()  # the only valid values; empty: all values of the range are valid

    @property
    def allowed(self) -> str:
        if self.choices:
            return ", ".join(map(str, self.choices))
        return f"{self.low:g} to {self.high:g}" if self.low < self.high else f"{self.low:g}"

    def accepts(self, value: float) -> bool:
        # Single precision rounds the ends of a range, so a tolerance is needed.
        slack = 1e-6 * max(1.0, abs(self.low), abs(self.high))
        if not (math.isfinite(value) and self.low - slack <= value <= self.high + slack):
            return False
        return not self.choices or value in self.choices


def real(name: str, default: float, low: float, high: float, *, in_flight: bool = False) -> Parameter:
    return Parameter(name, REAL32, default, low, high, in_flight)


def one_of(name: str, default: int, *choices: int) -> Parameter:
    """Return an integer parameter with the given choices, in ascending order."""
    return Parameter(name, INT32, default, choices[0], choices[-1], choices=choices)


def fixed(name: str, value: float, type_: int = INT32) -> Parameter:
    return Parameter(name, type_, value, value, value)


class Parameters:
    """Current values, read as ``parameters["COM_OF_LOSS_T"]``, and replies to clients that read or write."""

    def __init__(self, rows: Iterable[Parameter]) -> None:
        """Set the defaults; the parameters are sorted by name."""
        self.table = {row.name: row for row in sorted(rows, key=attrgetter("name"))}
        self._values = {name: row.default for name, row in self.table.items()}
        self.left_to_list: list[str] = []  # names of the requested list that are still to be sent

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def preset(self, name: str, value: float) -> None:
        """Set a parameter before the start; fixed parameters cannot change afterwards."""
        parameter = self.table.get(name)
        if parameter is None:
            raise ValueError(f"parameter {name!r} is not known: allowed is {', '.join(self.table)}")
        if not parameter.accepts(value) or (parameter.type != REAL32 and value != int(value)):
            raise ValueError(f"parameter {name}: found {value:g}, allowed is {parameter.allowed}")
        self._values[name] = value

    def list_all(self, _request: Any, _sender: Sender, _now_s: float) -> list[Message]:
        """Start to send every value with the telemetry; a request during a list starts the list again."""
        self.left_to_list = list(self.table)
        return []

    def listing(self) -> list[Message]:
        """Return PARAM_VALUE of the next parameters of the requested list; empty: no list is requested."""
        names, self.left_to_list = self.left_to_list[:_LIST_AT_ONCE], self.left_to_list[_LIST_AT_ONCE:]
        return [self._message(name) for name in names]

    def read(self, request: Any, sender: Sender, _now_s: float) -> list[Message]:
        """Return the value that PARAM_REQUEST_READ requests by index or, with index -1, by name."""
        name, index = request.param_id, request.param_index
        found = name if index < 0 else next(islice(self.table, index, None), "")
        known = found in self.table
        return [self._message(found) if known else _error(name, _UNKNOWN, sender, max(index, -1))]

    def write(
        self, request: Any, sender: Sender, forbidden: str | None, *, armed: bool
    ) -> tuple[list[Message], str | None]:
        """Handle PARAM_SET; refuse it for the reason ``forbidden``. Return replies, and a reason or None."""
        name, type_, value = request.param_id, request.param_type, request.param_value
        parameter = self.table.get(name)
        if parameter is None:
            return [_error(name, _UNKNOWN, sender)], None
        if type_ == parameter.type == INT32:  # the float field carries the bits of the integer
            value = float(_INT.unpack(_FLOAT.pack(value))[0])
        error, reason = _NOT_NOW, None
        if forbidden is not None:
            reason = f"{name} refused: {forbidden}"
        elif type_ != parameter.type:  # the dialect has no error for a wrong type
            error, reason = _OUT_OF_RANGE, f"{name}: ignored, type {type_} instead of {parameter.type}"
        elif not parameter.accepts(value):
            error = _OUT_OF_RANGE if parameter.low < parameter.high else _READ_ONLY
            reason = f"{name}: {value:.6g}, allowed {parameter.allowed}"
        elif armed and not parameter.in_flight:
            reason = f"{name}: only while disarmed"
        else:
            self._values[name] = min(max(value, parameter.low), parameter.high)
        # The error is sent first: MAVSDK treats a different value as a lost write and repeats it five times.
        errors = [_error(name, error, sender)] if reason is not None else []
        return [*errors, self._message(name)], reason

    def _message(self, name: str) -> Message:
        type_, value, index = self.table[name].type, self._values[name], list(self.table).index(name)
        if type_ == INT32:
            (value,) = _FLOAT.unpack(_INT.pack(int(value)))
        return dialect.MAVLink_param_value_message(name.encode(), value, type_, len(self.table), index)


def _error(name: str, error: int, sender: Sender, index: int = -1) -> Message:
    """Return PARAM_ERROR (mavlink.io, services/parameter); PX4 sends no reply, so clients wait seconds."""
    return dialect.MAVLink_param_error_message(*sender[:2], name.encode("ascii", "replace"), index, error)
