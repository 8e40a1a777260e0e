"""Memory layout of core objects for compiled code, from the annotations of their classes."""

from __future__ import annotations

import dataclasses
import types as python_types
import typing
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

from flightstack.core.numeric import UNSEEN

WORD = 8  # size of a double or integer, bytes
_texts: list[str] = [""]


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
        if self.parts:
            return "".join(part.format for part in self.parts)
        return "d" if self.hint is float else "q"

    def taken(self, path: str) -> str:
        """Return a Python expression for the elements of a value, in the order of compiled memory."""
        if not self.parts:
            if self.hint is str:
                return f"code({path})"
            return f"at.get(id({path}), 0)" if self.is_object else path
        if all(part.hint in (float, int, bool) and not part.parts for part in self.parts):
            return f"*{path}"
        return ", ".join(part.taken(f"{path}[{n}]") for n, part in enumerate(self.parts))

    def made(self, at: int, scope: dict[str, Any]) -> str:
        """Return a Python expression for the value whose elements start at ``v[at]``."""
        if self.parts:
            if get_origin(self.hint) is tuple and set(self.format) == {"d"} and not self.parts[0].parts:
                return f"v[{at}:{at + len(self.parts)}]"
            ends = [at]
            for part in self.parts:
                ends.append(ends[-1] + len(part.format))
            inner = "".join(f"{part.made(n, scope)}, " for part, n in zip(self.parts, ends, strict=False))
            if get_origin(self.hint) is tuple:
                return f"({inner})"
            scope[self.hint.__name__] = self.hint
            return f"{self.hint.__name__}({inner})"
        if self.hint in (float, int):
            return f"v[{at}]"
        if self.hint is str:
            return f"texts[v[{at}]]"
        scope[self.hint.__name__] = self.hint
        return f"{self.hint.__name__}(v[{at}])"


def is_enum(hint: Any) -> bool:
    """Whether a declared type is an ``IntEnum``."""
    return isinstance(hint, type) and issubclass(hint, IntEnum)


def kind_of_hint(hint: Any) -> Kind | None:
    """Return the layout of a declared type; ``None`` if compiled code cannot hold it."""
    if get_origin(hint) is Annotated:
        return None if UNSEEN in get_args(hint) else kind_of_hint(get_args(hint)[0])
    if get_origin(hint) in (typing.Union, python_types.UnionType):
        given = [each for each in get_args(hint) if each is not type(None)]
        return kind_of_hint(given[0]) if len(given) == 1 else None
    if hint in (float, int, bool, str) or is_enum(hint):
        return Kind(hint)
    if get_origin(hint) is tuple:
        inner = [kind_of_hint(each) for each in get_args(hint) if each is not Ellipsis]
        known = Ellipsis not in get_args(hint) and inner and all(inner)
        return Kind(hint, tuple(each for each in inner if each)) if known else None
    if not isinstance(hint, type) or get_origin(hint) is not None:
        return None
    if issubclass(hint, tuple) and hasattr(hint, "_fields"):
        inner = [kind_of_hint(each) for each in get_type_hints(hint, include_extras=True).values()]
        return Kind(hint, tuple(each for each in inner if each)) if all(inner) else None
    return Kind(hint) if getattr(hint, "__module__", "").startswith("flightstack.core") else None


def is_state(cls: type) -> bool:
    """Whether objects of a class are state that changes: dataclasses that are not frozen."""
    return dataclasses.is_dataclass(cls) and not cls.__dataclass_params__.frozen  # type: ignore[attr-defined]


@cache
def fields_of(cls: Any) -> dict[str, tuple[Kind, int]]:
    """Return the fields of a class that compiled code can hold, each with the index of its first element."""
    found, at = {}, 0
    for name, hint in get_type_hints(cls, include_extras=True).items():
        if get_origin(hint) is typing.ClassVar or (kind := kind_of_hint(hint)) is None:
            continue
        may_lack = get_origin(hint) in (typing.Union, python_types.UnionType)
        if not may_lack or kind.is_object or is_state(cls):  # a constant that may be None has no type
            found[name] = (kind, at)
            at += len(kind.format)
    return found


@cache
def objects_of(cls: Any) -> dict[str, Any]:
    """Return the fields of a class that hold other objects, each with its declared class."""
    return {name: kind.hint for name, (kind, _) in fields_of(cls).items() if kind.is_object}


@cache
def reader_of(cls: Any) -> Callable[[Any, tuple[Any, ...]], None]:
    """Return a function that sets the fields of an object, except objects, from elements of memory."""
    scope: dict[str, Any] = {"texts": _texts}
    lines = [f"    o.{n} = {k.made(at, scope)}" for n, (k, at) in fields_of(cls).items() if not k.is_object]
    exec("def read(o, v):\n" + "\n".join([*lines, "    return"]), scope)
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
def format_of(cls: Any) -> str:
    return "".join(kind.format for kind, _ in fields_of(cls).values())
