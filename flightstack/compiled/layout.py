"""Memory layout of core objects for compiled code, from the annotations of their classes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from enum import IntEnum
from functools import cache
from itertools import count
from struct import Struct
from types import UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from flightstack.core.numeric import UNSEEN

_UNIONS = (Union, UnionType)
WORD = 8  # size of a double or integer, bytes
_texts: list[str] = [""]  # texts of fields; compiled memory has the index of a text in this list


def _code(text: str) -> int:
    if text not in _texts:
        _texts.append(text)
    return _texts.index(text)


class Kind(NamedTuple):
    """Memory layout of a declared type: a scalar, a tuple of other kinds, or the address of an object."""

    hint: Any
    parts: tuple[Kind, ...] = ()

    @property
    def is_object(self) -> bool:
        """Whether the value is the address of an object."""
        return not self.parts and self.hint not in (float, int, bool, str) and not is_enum(self.hint)

    @property
    def format(self) -> str:
        """Format string for ``struct``."""
        return "".join(part.format for part in self.parts) or ("d" if self.hint is float else "q")

    def taken(self, path: str) -> str:
        """Return a Python expression for the elements of a value, in the order of compiled memory."""
        if all(part.hint in (float, int, bool) for part in self.parts or (self,)):
            return f"*{path}" if self.parts else path
        if self.hint is str:
            return f"code({path})"
        if self.is_object:
            return f"at.get(id({path}), 0)"
        return ", ".join(part.taken(f"{path}[{n}]") for n, part in enumerate(self.parts)) or path

    def made(self, words: Iterator[str], scope: dict[str, Any]) -> str:
        """Return a Python expression for the value; ``words``: expressions for its elements."""
        scope[self.hint.__name__] = self.hint
        if self.parts:
            inner = "".join(f"{part.made(words, scope)}, " for part in self.parts)
            return f"({inner})" if self.hint.__name__ == "tuple" else f"{self.hint.__name__}({inner})"
        word = next(words)
        if self.hint in (float, int):
            return word
        return f"texts[{word}]" if self.hint is str else f"{self.hint.__name__}({word})"


def is_enum(hint: Any) -> bool:
    """Whether a declared type is an ``IntEnum``."""
    return isinstance(hint, type) and issubclass(hint, IntEnum)


def kind_of_hint(hint: Any) -> Kind | None:
    """Return the layout of a declared type; ``None`` if compiled code cannot hold it."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return None if UNSEEN in inner else kind_of_hint(inner[0])
    if origin in _UNIONS:
        given = [each for each in inner if each is not type(None)]
        return kind_of_hint(given[0]) if len(given) == 1 else None
    if hint in (float, int, bool, str) or is_enum(hint):
        return Kind(hint)
    if hasattr(hint, "_fields"):
        inner = tuple(get_type_hints(hint, include_extras=True).values())
    elif origin is not tuple:
        held = isinstance(hint, type) and hint.__module__.startswith("flightstack.")
        return Kind(hint) if held and origin is None else None
    parts = tuple(kind for each in inner if (kind := kind_of_hint(each)) is not None)
    return Kind(hint, parts) if parts and len(parts) == len(inner) else None


def is_state(cls: type) -> bool:
    """Whether objects of a class contain state that changes: the class is a dataclass that is not frozen."""
    return dataclasses.is_dataclass(cls) and not cls.__dataclass_params__.frozen  # type: ignore[attr-defined]


@cache
def fields_of(cls: Any) -> dict[str, tuple[Kind, int]]:
    """Return the fields of a class that compiled code can hold, each with the index of its first element."""
    found, at = {}, 0
    for name, hint in get_type_hints(cls, include_extras=True).items():
        kind = kind_of_hint(hint)
        if kind is None or not (kind.is_object or is_state(cls) or get_origin(hint) not in _UNIONS):
            continue  # a constant that can be None has no type in compiled code
        found[name] = (kind, at)
        at += len(kind.format)
    return found


@cache
def objects_of(cls: Any) -> dict[str, Any]:
    """Return the fields of a class that hold other objects, each with its declared class."""
    return {name: kind.hint for name, (kind, _) in fields_of(cls).items() if kind.is_object}


@cache
def reader_of(cls: Any) -> Callable[[Any, tuple[Any, ...]], None]:
    """Return a function that sets an object's fields from memory, except fields that hold objects."""
    scope: dict[str, Any] = {"texts": _texts}
    lines = [
        f"    o.{name} = {kind.made((f'v[{n}]' for n in count(at)), scope)}"
        for name, (kind, at) in fields_of(cls).items()
        if not kind.is_object
    ]
    exec("\n".join(["def read(o, v):", *lines, "    return"]), scope)
    return scope["read"]  # type: ignore[no-any-return]


@cache
def taker_of(cls: Any) -> Callable[[Any, dict[int, int]], tuple[Any, ...]]:
    """Return a function that returns the elements of an object, in the order of compiled memory."""
    parts = "".join(f"{kind.taken(f'o.{name}')}, " for name, (kind, _) in fields_of(cls).items())
    scope: dict[str, Any] = {"code": _code}
    exec(f"def take(o, at):\n    return ({parts})", scope)
    return scope["take"]  # type: ignore[no-any-return]


def class_of(one: object) -> Any:
    """Return the class of an object; for a user's filter, the packaged class that is compiled."""
    return getattr(one, "compiled_as", type(one))


@cache
def struct_of(cls: Any) -> Struct:
    """Return the layout of an object's elements in memory."""
    return Struct("=" + "".join(kind.format for kind, _ in fields_of(cls).values()))
