"""Dataclasses as text and back, by their declared types and without losing a bit.

For what a process remembers and writes into its log: what a field may hold is settled when the codec is made,
so a type that cannot be written stops a program at its start and never in flight. The ``layout`` names every
field and type; text of another layout is refused, not guessed at.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
import types
import typing
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any, Generic, NamedTuple, TypeVar

T = TypeVar("T")

VERSION = 1  # version of the text form
_WRITER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, check_circular=False)
_BITS = "f64:"  # a float that JSON has no word for: the 16 digits of its IEEE 754 bits, big-endian


class StateTextError(ValueError):
    """Text that is not of this type."""


class _Plan(NamedTuple):
    """How one declared type is written."""

    layout: str
    encode: Callable[[Any], Any]
    decode: Callable[[Any, str], Any]


class StateText(Generic[T]):
    """Writes and reads one dataclass."""

    def __init__(self, cls: type[T]) -> None:
        """Settle how each field is written.

        Raises TypeError: A field's declared type is not one of bool, int, float, str, enum, tuple, dataclass,
        named tuple, or one of these or None.
        """
        self._plan = _plan(cls, cls.__name__)
        self.layout = f"{VERSION} {self._plan.layout}"  # Version, then names and types of all fields

    def dumps(self, value: T) -> str:
        """Return the value as text."""
        return _WRITER.encode(self._plan.encode(value))

    def loads(self, layout: str, text: str) -> T:
        """Return the value that :meth:`dumps` wrote.

        Raises StateTextError: Of another layout, or not such a text.
        """
        if layout != self.layout:
            raise StateTextError(f"layout {layout!r} found, this version reads {self.layout!r}")
        try:
            plain = json.loads(text, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise StateTextError(f"not JSON: {error}") from error
        value: T = self._plan.decode(plain, "")
        return value


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not allowed; such numbers are written {_BITS}...")


def _plan(hint: Any, where: str) -> _Plan:
    origin = typing.get_origin(hint)
    if hint is float:
        return _Plan("float", _encode_float, _decode_float)
    if hint in (bool, int, str):
        return _Plan(hint.__name__, hint, lambda v, at: _exactly(hint, v, at))
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _enum(hint)
    if origin in (typing.Union, types.UnionType):
        return _optional(hint, where)
    if origin is tuple:
        return _row(hint, where) if Ellipsis in typing.get_args(hint) else _tuple(hint, where)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _named(hint, [f.name for f in dataclasses.fields(hint)])
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        return _named(hint, hint._fields)
    raise TypeError(f"{where}: declared {hint}, which has no text form here; see StateText")


def _encode_float(value: float) -> float | str:
    return float(value) if math.isfinite(value) else _BITS + struct.pack(">d", value).hex()


def _decode_float(value: Any, at: str) -> float:
    if isinstance(value, str) and value.startswith(_BITS):
        try:
            number: float = struct.unpack(">d", bytes.fromhex(value.removeprefix(_BITS)))[0]
        except (ValueError, struct.error) as error:
            raise StateTextError(f"{at}: found {value!r}, 16 hexadecimal digits are needed") from error
        return number
    return float(_exactly(float, value, at))


def _exactly(kind: type, value: Any, at: str) -> Any:
    if type(value) is not kind:
        raise StateTextError(f"{at or 'the whole'}: found {value!r}, {kind.__name__} is needed")
    return value


def _enum(hint: type[Enum]) -> _Plan:
    members = hint.__members__

    def decode(value: Any, at: str) -> Any:
        if not isinstance(value, str) or value not in members:
            raise StateTextError(f"{at}: found {value!r}, allowed: {', '.join(members)}")
        return members[value]

    return _Plan(hint.__name__, lambda value: value.name, decode)


def _optional(hint: Any, where: str) -> _Plan:
    given = [each for each in typing.get_args(hint) if each is not type(None)]
    if len(given) != 1 or len(typing.get_args(hint)) != 2:
        raise TypeError(f"{where}: declared {hint}; only one type or None can be told apart again")
    inner = _plan(given[0], where)
    return _Plan(
        inner.layout + "?",
        lambda value: None if value is None else inner.encode(value),
        lambda value, at: None if value is None else inner.decode(value, at),
    )


def _tuple(hint: Any, where: str) -> _Plan:
    inner = [_plan(each, where) for each in typing.get_args(hint)]

    def decode(value: Any, at: str) -> Any:
        if not isinstance(value, list) or len(value) != len(inner):
            raise StateTextError(f"{at}: found {value!r}, {len(inner)} values are needed")
        pairs = enumerate(zip(inner, value, strict=True))
        return tuple(each.decode(v, f"{at}[{n}]") for n, (each, v) in pairs)

    def encode(value: Any) -> list[Any]:
        return [each.encode(v) for each, v in zip(inner, value, strict=True)]

    return _Plan(f"({','.join(each.layout for each in inner)})", encode, decode)


def _row(hint: Any, where: str) -> _Plan:
    """A tuple of any length."""
    inner = _plan(typing.get_args(hint)[0], where)

    def decode(value: Any, at: str) -> Any:
        if not isinstance(value, list):
            raise StateTextError(f"{at}: found {value!r}, a list is needed")
        return tuple(inner.decode(v, f"{at}[{n}]") for n, v in enumerate(value))

    return _Plan(f"({inner.layout}...)", lambda value: [inner.encode(v) for v in value], decode)


def _named(cls: type, names: Sequence[str]) -> _Plan:
    hints = typing.get_type_hints(cls)
    plans = {name: _plan(hints[name], f"{cls.__name__}.{name}") for name in names}

    def encode(value: Any) -> dict[str, Any]:
        return {name: plan.encode(getattr(value, name)) for name, plan in plans.items()}

    def decode(value: Any, at: str) -> Any:
        if not isinstance(value, dict) or value.keys() != plans.keys():
            found = sorted(value) if isinstance(value, dict) else value
            raise StateTextError(f"{at or cls.__name__}: found {found!r}, needed are {sorted(plans)}")
        dot = f"{at}." if at else ""
        return cls(**{name: plan.decode(value[name], dot + name) for name, plan in plans.items()})

    layout = ",".join(f"{name}:{plan.layout}" for name, plan in plans.items())
    return _Plan(f"{cls.__name__}({layout})", encode, decode)
