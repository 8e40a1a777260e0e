"""Conversion of dataclasses to text, according to their declared types and without rounding.

The writer is built from the types, so an unsupported type stops a program at its start and never in flight.
The ``layout`` names every field and type; only texts of one layout can be compared.
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
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class

T = TypeVar("T")

VERSION = 2  # version of the text form
_WRITER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, check_circular=False)
_BITS = "f64:"  # prefix of a float that JSON cannot represent: 16 hex digits of its IEEE 754 bits, big-endian


class _Plan(NamedTuple):
    """Encoder of one declared type; ``layout``: text that describes the type."""

    layout: str
    encode: Callable[[Any], Any]


class StateText(Generic[T]):
    """Writer of the objects of one class; ``given``: types for its fields that are declared Any.

    The text leaves out each field that equals its default, if ``cls()`` is possible.
    Raises TypeError: the declared type of a field is not bool, int, float, str, enum, tuple, dataclass, named
    tuple, or a union of one of these with None.
    """

    def __init__(self, cls: type[T], **given: Any) -> None:
        self._plan = _named(cls, given)
        self.layout = f"{VERSION} {self._plan.layout}"  # version, then names and types of all fields
        self._omitted: dict[str, str] = {}
        if dataclasses.is_dataclass(cls) and not any(map(_is_required, dataclasses.fields(cls))):
            self._omitted = {name: _WRITER.encode(each) for name, each in self._plan.encode(cls()).items()}

    def dumps(self, value: T) -> str:
        texts = [(name, _WRITER.encode(each)) for name, each in self._plan.encode(value).items()]
        written = [f'"{name}":{text}' for name, text in texts if text != self._omitted.get(name)]
        return f"{{{','.join(written)}}}"


def state_text(config: FlightConfig) -> StateText[State]:
    """Return the writer of the controller's state, which includes the state of the configured filter."""
    own = strategy_class(config.filter).State
    return StateText(State) if own is None else StateText(State, filter_state=own | None)


def _is_required(field: Any) -> bool:
    return field.default is field.default_factory  # True only if both are MISSING


def _plan(hint: Any, where: str) -> _Plan:
    inner, kind = get_args(hint), hint if isinstance(hint, type) else object
    if hint is float:
        return _Plan("float", _encode_float)
    if hint is Any:
        return _Plan("none", lambda _: None)
    if hint in (bool, int, str):
        return _Plan(hint.__name__, hint)
    if issubclass(kind, Enum):
        return _Plan(kind.__name__, lambda v: v.name)
    if get_origin(hint) in (Union, UnionType) and len(inner) == 2 and NoneType in inner:
        one = _plan(next(each for each in inner if each is not NoneType), where)
        return _Plan(one.layout + "?", lambda v: None if v is None else one.encode(v))
    if get_origin(hint) is tuple:
        return _tuple(inner, where)
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        return _named(kind)
    raise TypeError(f"{where}: declared {hint}, which has no text form here; see StateText")


def _encode_float(value: float) -> float | str:
    return float(value) if math.isfinite(value) else _BITS + struct.pack(">d", value).hex()


def _tuple(hints: tuple[Any, ...], where: str) -> _Plan:
    """Return the encoder of a tuple: one type per value, or any number of values of one type (``...``)."""
    is_row = hints[-1] is Ellipsis
    plans = [_plan(each, where) for each in hints if each is not Ellipsis]

    def encode(values: Any) -> list[Any]:
        each = plans * len(values) if is_row else plans
        return [plan.encode(value) for plan, value in zip(each, values, strict=True)]

    return _Plan(f"({','.join(plan.layout for plan in plans)}{'...' if is_row else ''})", encode)


def _named(cls: Any, given: Mapping[str, Any] = MappingProxyType({})) -> _Plan:
    """Return the encoder of a dataclass or named tuple."""
    hints = {**get_type_hints(cls), **given}
    names = cls._fields if hasattr(cls, "_fields") else [f.name for f in dataclasses.fields(cls)]
    plans = {name: _plan(hints[name], f"{cls.__name__}.{name}") for name in names}
    return _Plan(
        f"{cls.__name__}({','.join(f'{name}:{plan.layout}' for name, plan in plans.items())})",
        lambda value: {name: plan.encode(getattr(value, name)) for name, plan in plans.items()},
    )
