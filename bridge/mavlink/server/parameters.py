"""Parameters of a vehicle: read, listed and written by MAVLink's parameter protocol."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message

INT32 = dialect.MAV_PARAM_TYPE_INT32
REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_FLOAT = struct.Struct("<f")
_INT = struct.Struct("<i")
_LIST_AT_ONCE = 20  # number of PARAM_VALUE messages per tick of a requested list, as PX4 sends over UDP
_OUT_OF_RANGE = dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE  # the dialect has no error for a wrong type
_READ_ONLY = dialect.MAV_PARAM_ERROR_READ_ONLY
NOT_NOW = dialect.MAV_PARAM_ERROR_PERMISSION_DENIED


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter: default, allowed range (including both ends), and whether it may change in flight."""

    name: str  # name of at most 16 characters
    type: int  # type number of MAVLink (MAV_PARAM_TYPE); PX4 has only INT32 and REAL32
    default: float
    low: float
    high: float
    in_flight: bool = False
    choices: tuple[int, ...] = ()  # only valid values; empty: all values of the range are valid

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


def integer(name: str, default: int, low: int, high: int) -> Parameter:
    return Parameter(name, INT32, default, low, high)


def one_of(name: str, default: int, *choices: int) -> Parameter:
    """Return an integer parameter with the given choices, in ascending order."""
    return Parameter(name, INT32, default, choices[0], choices[-1], choices=choices)


def fixed(name: str, value: float, type_: int = INT32) -> Parameter:
    return Parameter(name, type_, value, value, value)


class Refused(NamedTuple):
    error: int  # error number of MAVLink (MAV_PARAM_ERROR)
    reason: str


class Parameters:
    """Current values, read as ``parameters["COM_OF_LOSS_T"]``."""

    def __init__(self, rows: Iterable[Parameter]) -> None:
        """Set the defaults; the parameters are sorted by name."""
        self._table = tuple(sorted(rows, key=lambda parameter: parameter.name))
        self._index = {parameter.name: i for i, parameter in enumerate(self._table)}
        self._values = {parameter.name: parameter.default for parameter in self._table}
        self.left_to_list: list[str] = []  # names of the requested list that are still to be sent

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __len__(self) -> int:
        return len(self._table)

    def entry(self, name: str) -> Parameter:
        return self._table[self._index[name]]

    def find(self, name: str, index: int) -> str | None:
        """Return the name of a parameter requested by name (index -1) or by index; None: unknown."""
        if index >= 0:
            return self._table[index].name if index < len(self._table) else None
        return name if name in self._index else None

    def message(self, name: str) -> Message:
        index = self._index[name]
        parameter = self._table[index]
        value = self._values[name]
        if parameter.type == INT32:  # the float field carries the bits of the integer
            (value,) = _FLOAT.unpack(_INT.pack(int(value)))
        return dialect.MAVLink_param_value_message(
            name.encode(), value, parameter.type, len(self._table), index
        )

    def preset(self, name: str, value: float) -> None:
        """Set a parameter before the start; fixed parameters cannot change afterwards."""
        if name not in self._index:
            raise ValueError(f"parameter {name!r} is not known: allowed is {', '.join(self._index)}")
        parameter = self.entry(name)
        if not parameter.accepts(value) or (parameter.type != REAL32 and value != int(value)):
            raise ValueError(f"parameter {name}: found {value:g}, allowed is {parameter.allowed}")
        self._values[name] = value

    def list_all(self) -> None:
        """Start to send every value; a request during a list starts the list again."""
        self.left_to_list = list(self._index)

    def listing(self) -> list[Message]:
        """Return PARAM_VALUE of the next parameters of the requested list; empty: no list is requested."""
        names, self.left_to_list = self.left_to_list[:_LIST_AT_ONCE], self.left_to_list[_LIST_AT_ONCE:]
        return [self.message(name) for name in names]

    def set(self, name: str, wire_value: float, type_: int, *, armed: bool) -> Refused | None:
        """Write PARAM_SET's float field of this MAV_PARAM_TYPE; return why it is rejected, or None."""
        parameter = self._table[self._index[name]]
        if type_ != parameter.type:
            return Refused(_OUT_OF_RANGE, f"{name}: ignored, type {type_} instead of {parameter.type}")
        value = float(_INT.unpack(_FLOAT.pack(wire_value))[0]) if type_ == INT32 else wire_value
        if not parameter.accepts(value):
            error = _OUT_OF_RANGE if parameter.low < parameter.high else _READ_ONLY
            return Refused(error, f"{name}: {value:.6g}, allowed {parameter.allowed}")
        if armed and not parameter.in_flight:
            return Refused(NOT_NOW, f"{name}: only while disarmed")
        self._values[name] = min(max(value, parameter.low), parameter.high)
        return None
