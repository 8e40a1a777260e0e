"""Conversion of dataclasses to text and back, by their declared types and without rounding.

The codec is built from the types, so an unsupported type stops a program at its start and never in flight.
The ``layout`` names every field and type; a text with another layout is rejected.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from collections.abc import Callable, Mapping
from enum import Enum
from types import MappingProxyType, NoneType, UnionType
from typing import Any, Generic, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

from flightstack.core.memory import State
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class

T = TypeVar("T")

VERSION = 2  # version of the text form
_WRITER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, check_circular=False)
_BITS = "f64:"  # prefix of a float that JSON cannot represent: 16 hex digits of its IEEE 754 bits, big-endian


class StateTextError(ValueError):
    """The text does not contain a value of this type."""


class _Plan(NamedTuple):
    """Encoder and decoder of one declared type."""

    layout: str
    encode: Callable[[Any], Any]
    decode: Callable[[Any, str], Any]


class StateText(Generic[T]):
    """Writer and reader of the values of one class; ``given``: types of its fields of type Any.

    The text leaves out each field that equals its default, if ``cls()`` is possible.
    Raises TypeError: the declared type of a field is not bool, int, float, str, enum, tuple, dataclass, named
    tuple, or a union of one of these with None.
    """

    def __init__(self, cls: type[T], **given: Any) -> None:
        self._plan = _named(cls, given)
        self.layout = f"{VERSION} {self._plan.layout}"  # version, then names and types of all fields
        self._defaults: dict[str, Any] = {}
        if dataclasses.is_dataclass(cls) and not any(map(_is_required, dataclasses.fields(cls))):
            self._defaults = self._plan.encode(cls())
        self._omitted = {name: _WRITER.encode(each) for name, each in self._defaults.items()}

    def dumps(self, value: T) -> str:
        texts = [(name, _WRITER.encode(each)) for name, each in self._plan.encode(value).items()]
        written = [f'"{name}":{text}' for name, text in texts if text != self._omitted.get(name)]
        return f"{{{','.join(written)}}}"

    def loads(self, layout: str, text: str) -> T:
        """Return the value that ``dumps`` wrote. Raises StateTextError: wrong layout, or invalid text."""
        if layout != self.layout:
            raise StateTextError(f"layout {layout!r} found, this version reads {self.layout!r}")
        try:
            plain = json.loads(text, parse_constant=_refuse)
        except (ValueError, RecursionError) as error:
            raise StateTextError(f"not JSON: {error}") from error
        value: T = self._plan.decode({**self._defaults, **plain} if isinstance(plain, dict) else plain, "")
        return value


def state_text(config: FlightConfig) -> StateText[State]:
    """Return the writer and reader of the controller's state; a user's filter may have a state of its own."""
    own = None if config.filter in FILTERS else strategy_class(config.filter).State
    return StateText(State) if own is None else StateText(State, filter_state=own | None)


def _is_required(field: Any) -> bool:
    return field.default is field.default_factory  # then both are MISSING


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not allowed; such numbers are written {_BITS}...")


def _is(value: Any, good: bool, at: str, needed: str) -> Any:
    """Return the value. Raises StateTextError: ``good`` is false."""
    if not good:
        raise StateTextError(f"{at or 'the whole'}: found {value!r}, {needed} is needed")
    return value


def _plan(hint: Any, where: str) -> _Plan:
    inner, kind = get_args(hint), hint if isinstance(hint, type) else object
    if hint is float:
        return _Plan("float", _encode_float, _decode_float)
    if hint is Any:
        return _Plan("none", *(lambda v, at=where: _is(v, v is None, at, "None"),) * 2)
    if hint in (bool, int, str):
        name = hint.__name__
        return _Plan(name, hint, lambda v, at: _is(v, type(v) is hint, at, name))
    if issubclass(kind, Enum):
        members = kind.__members__
        names = f"one of {', '.join(members)}"
        return _Plan(
            kind.__name__,
            lambda v: v.name,
            lambda v, at: members[_is(v, isinstance(v, str) and v in members, at, names)],
        )
    if get_origin(hint) in (Union, UnionType) and len(inner) == 2 and NoneType in inner:
        one = _plan(next(each for each in inner if each is not NoneType), where)
        return _Plan(
            one.layout + "?",
            lambda v: None if v is None else one.encode(v),
            lambda v, at: None if v is None else one.decode(v, at),
        )
    if get_origin(hint) is tuple:
        return _tuple(inner, where)
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        return _named(kind)
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
    return float(_is(value, type(value) is float, at, "float"))


def _tuple(hints: tuple[Any, ...], where: str) -> _Plan:
    """Return the plan of a tuple: one type per value, or any number of values of one type (``...``)."""
    is_row = hints[-1] is Ellipsis
    plans = [_plan(each, where) for each in hints if each is not Ellipsis]
    needed = "a list" if is_row else f"a list of {len(plans)} values"

    def each(values: Any) -> zip[tuple[_Plan, Any]]:
        return zip(plans * len(values) if is_row else plans, values, strict=True)

    def decode(value: Any, at: str) -> Any:
        _is(value, isinstance(value, list) and (is_row or len(value) == len(plans)), at, needed)
        return tuple(plan.decode(v, f"{at}[{n}]") for n, (plan, v) in enumerate(each(value)))

    layouts = ",".join(plan.layout for plan in plans)
    return _Plan(
        f"({layouts}{'...' if is_row else ''})", lambda value: [p.encode(v) for p, v in each(value)], decode
    )


def _named(cls: Any, given: Mapping[str, Any] = MappingProxyType({})) -> _Plan:
    """Return the plan of a dataclass or named tuple."""
    hints = {**get_type_hints(cls), **given}
    names = cls._fields if hasattr(cls, "_fields") else [f.name for f in dataclasses.fields(cls)]
    plans = {name: _plan(hints[name], f"{cls.__name__}.{name}") for name in names}

    def decode(value: Any, at: str) -> Any:
        good = isinstance(value, dict) and value.keys() == plans.keys()
        _is(value, good, at or cls.__name__, f"a table of {sorted(plans)}")
        dot = f"{at}." if at else ""
        return cls(**{name: plan.decode(value[name], dot + name) for name, plan in plans.items()})

    return _Plan(
        f"{cls.__name__}({','.join(f'{name}:{plan.layout}' for name, plan in plans.items())})",
        lambda value: {name: plan.encode(getattr(value, name)) for name, plan in plans.items()},
        decode,
    )
