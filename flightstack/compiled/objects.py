"""Objects of the core in compiled code: one source for both, generated from the annotations of their classes.

Compiled code gets an object by address, and reads and writes its annotated fields there: numbers, tuples of
them, named tuples, texts (as numbers that stand for them), and other objects. It calls the methods of the
object's class, compiled. Fields of any other kind do not exist for compiled code; one that may be ``None`` is
never ``None`` there. Dataclasses that are not frozen are state: ``Objects.write`` copies it from Python's
objects and ``Objects.read`` copies it back. All else is copied once.
"""

from __future__ import annotations

import dataclasses
import inspect
import struct
import types as python_types
import typing
from collections.abc import Callable, Iterator
from enum import IntEnum
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import numpy as np

from flightstack.compiled.jit import is_off, jitted, load_numba
from flightstack.core.numeric import ABSENT, MARKED, RARE, UNSEEN, NotOrdinary, scope_of

_WORD = 8  # bytes of each number: doubles and whole numbers of 64 bits
_texts: list[str] = [""]


def _none(value: object) -> tuple[()]:
    if value is not None:
        raise TypeError("compiled code knows only that it is not there")
    return ()


def _code(text: str) -> int:
    if text not in _texts:
        _texts.append(text)
    return _texts.index(text)


class Kind(NamedTuple):
    """How a declared type lies in memory: a scalar, a tuple of others, or the address of an object."""

    hint: Any
    parts: tuple[Kind, ...] = ()

    @property
    def is_object(self) -> bool:
        """Whether it is the address of an object."""
        if self.hint is None:
            return False
        return not self.parts and self.hint not in (float, int, bool, str) and not _is_enum(self.hint)

    @property
    def format(self) -> str:
        """As ``struct`` writes it."""
        if self.hint is None:
            return ""
        if self.parts:
            return "".join(part.format for part in self.parts)
        return "d" if self.hint is float else "q"

    def taken(self, path: str) -> str:
        """Python's expression for the numbers of a value."""
        if not self.parts:
            if self.hint is None:
                return f"*none({path})"
            return (
                f"code({path})" if self.hint is str else f"at.get(id({path}), 0)" if self.is_object else path
            )
        if all(part.hint in (float, int, bool) and not part.parts for part in self.parts):
            return f"*{path}"
        return ", ".join(part.taken(f"{path}[{n}]") for n, part in enumerate(self.parts))

    def made(self, at: int, scope: dict[str, Any]) -> str:
        """Python's expression for a value of the numbers ``v`` from an index on."""
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
        if self.hint is None:
            return "None"
        if self.hint in (float, int):
            return f"v[{at}]"
        if self.hint is str:
            return f"texts[v[{at}]]"
        scope[self.hint.__name__] = self.hint
        return f"{self.hint.__name__}(v[{at}])"


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, IntEnum)


def _kind(hint: Any) -> Kind | None:
    """``None`` for what compiled code cannot hold."""
    if get_origin(hint) is Annotated:
        if UNSEEN in get_args(hint):
            return None
        return Kind(None) if ABSENT in get_args(hint) else _kind(get_args(hint)[0])
    if get_origin(hint) in (typing.Union, python_types.UnionType):
        given = [each for each in get_args(hint) if each is not type(None)]
        return _kind(given[0]) if len(given) == 1 else None
    if hint in (float, int, bool, str) or _is_enum(hint):
        return Kind(hint)
    if get_origin(hint) is tuple:
        inner = [_kind(each) for each in get_args(hint) if each is not Ellipsis]
        known = Ellipsis not in get_args(hint) and inner and all(inner)
        return Kind(hint, tuple(each for each in inner if each)) if known else None
    if not isinstance(hint, type) or get_origin(hint) is not None:
        return None
    if issubclass(hint, tuple) and hasattr(hint, "_fields"):
        inner = [_kind(each) for each in get_type_hints(hint, include_extras=True).values()]
        return Kind(hint, tuple(each for each in inner if each)) if all(inner) else None
    return Kind(hint) if getattr(hint, "__module__", "").startswith("flightstack.core") else None


def _is_state(cls: type) -> bool:
    return dataclasses.is_dataclass(cls) and not cls.__dataclass_params__.frozen  # type: ignore[attr-defined]


@cache
def fields_of(cls: Any) -> dict[str, tuple[Kind, int]]:
    """Fields of a class that compiled code can hold, and the place of each in numbers."""
    found, at = {}, 0
    for name, hint in get_type_hints(cls, include_extras=True).items():
        if get_origin(hint) is typing.ClassVar or (kind := _kind(hint)) is None:
            continue
        may_lack = get_origin(hint) in (typing.Union, python_types.UnionType)
        if not may_lack or kind.is_object or _is_state(cls):  # of a constant None is not known in time
            found[name] = (kind, at)
            at += len(kind.format)
    return found


@cache
def _reader(cls: Any) -> Callable[[Any, tuple[Any, ...]], None]:
    """Function that sets the fields of an object to numbers; it keeps those that hold other objects."""
    scope: dict[str, Any] = {"texts": _texts}
    lines = [f"    o.{n} = {k.made(at, scope)}" for n, (k, at) in fields_of(cls).items() if not k.is_object]
    exec("def read(o, v):\n" + "\n".join([*lines, "    return"]), scope)
    return scope["read"]  # type: ignore[no-any-return]


@cache
def _taker(cls: Any) -> Callable[[Any, dict[int, int]], tuple[Any, ...]]:
    """Function that returns the numbers of an object."""
    parts = "".join(f"{kind.taken(f'o.{name}')}, " for name, (kind, _) in fields_of(cls).items())
    scope: dict[str, Any] = {"code": _code, "none": _none}
    exec(f"def take(o, at):\n    return ({parts})", scope)
    return scope["take"]  # type: ignore[no-any-return]


def _class(one: object) -> Any:
    return type(one)


def _format(cls: Any) -> str:
    return "".join(kind.format for kind, _ in fields_of(cls).values())


class Handle(NamedTuple):
    """An object as an argument of compiled code."""

    kind: Any
    address: int


class Objects:
    """An object, and all that its fields lead to, in memory that compiled code can use."""

    def __init__(self, root: object) -> None:
        found = list(_reached(root, {}))
        self._state = [one for one in found if _is_state(_class(one))]
        others = [one for one in found if not _is_state(_class(one))]
        self.state, self.spare, self._constant = (
            np.zeros(sum(len(_format(_class(one))) for one in some) + 1)
            for some in (self._state, self._state, others)
        )
        self._at: dict[int, int] = {}
        for some, memory in ((self._state, self.state), (others, self._constant)):
            at = memory.ctypes.data
            for one in some:
                self._at[id(one)] = at
                at += _WORD * len(_format(_class(one)))
        whole = "".join(_format(_class(one)) for one in others)
        numbers = [number for one in others for number in _taker(_class(one))(one, self._at)]
        struct.pack_into(f"={whole}", self._constant.data, 0, *numbers)
        self._struct = struct.Struct("=" + "".join(_format(_class(one)) for one in self._state))
        self._root = root

    @property
    def handle(self) -> Handle:
        """The object itself."""
        return Handle(None if is_off() else kind_of(self._root), self._at[id(self._root)])

    def write(self) -> bool:
        """Copy the state from Python's objects; False where one of its fields is ``None``."""
        numbers: list[Any] = []
        try:
            for one in self._state:
                numbers += _taker(_class(one))(one, self._at)
            self._struct.pack_into(self.state.data, 0, *numbers)
        except (TypeError, struct.error):
            return False
        return True

    def write_one(self, one: object) -> None:
        """Copy a part of the state."""
        at = (self._at[id(one)] - self.state.ctypes.data) // _WORD
        numbers = _taker(_class(one))(one, self._at)
        struct.pack_into(f"={_format(_class(one))}", self.state.data, at * _WORD, *numbers)

    def read(self) -> None:
        """Copy the state back."""
        numbers, at = self._struct.unpack_from(self.state.data), 0
        for one in self._state:
            end = at + len(_format(_class(one)))
            _reader(_class(one))(one, numbers[at:end])
            at = end


def _reached(one: Any, known: dict[int, Any]) -> Iterator[Any]:
    """All objects that fields lead to, each once."""
    if id(one) in known:
        return
    known[id(one)] = one
    yield one
    for name, (kind, _) in fields_of(_class(one)).items():
        if kind.is_object and getattr(one, name) is not None:
            yield from _reached(getattr(one, name), known)


if TYPE_CHECKING or is_off():

    def kind_of(one: object) -> Any:
        """Type of an object for compiled code."""
        return type(one)

else:
    load_numba()
    from llvmlite import ir
    from numba.core import cgutils, types
    from numba.core.datamodel import models, register_default
    from numba.core.typing.templates import AttributeTemplate
    from numba.extending import (
        NativeValue,
        infer_getattr,
        intrinsic,
        lower_getattr_generic,
        lower_setattr_generic,
        overload_attribute,
        overload_method,
        typeof_impl,
        unbox,
    )

    class Held(types.Type):
        """An object by its address."""

        def __init__(self, cls: type, others: tuple[tuple[str, Any], ...]) -> None:
            self.cls, self.others = cls, dict(others)
            super().__init__(name=f"{cls.__module__}.{cls.__qualname__}{list(others) or ''}")

        def __reduce__(self) -> Any:
            return _held, (self.cls, tuple(self.others.items()))

        def type_of(self, name: str) -> Any:
            """Type of a field; None if it has none of this name."""
            if name in self.others:
                return self.others[name]
            found = fields_of(self.cls).get(name)
            return _numba_type(found[0]) if found else None

    def _numba_type(kind: Kind) -> Any:
        if kind.parts:
            inner = tuple(_numba_type(part) for part in kind.parts)
            if get_origin(kind.hint) is tuple:
                return types.BaseTuple.from_types(inner)
            return types.BaseTuple.from_types(inner, kind.hint)
        if kind.hint is None:
            return types.none
        if kind.hint is bool:
            return types.boolean
        if kind.hint is float:
            return types.float64
        if _is_enum(kind.hint):
            return types.IntEnumMember(kind.hint, types.int64)
        return types.int64 if kind.hint in (int, str) else _held(kind.hint, ())

    def _held(cls: type, others: tuple[tuple[str, Any], ...]) -> Held:
        return _class_of(cls)(cls, others)

    @cache
    def _class_of(cls: type) -> type[Held]:
        """Class of the types of one class's objects, with its methods."""
        made = type(cls.__name__, (Held,), {})
        register_default(made)(_Address)
        _register(made, cls)
        return made

    def _register(made: Any, cls: type) -> None:
        others = getattr(cls, "compiled", {})
        for name in dir(cls):
            one = others.get(name, getattr(cls, name))
            if isinstance(one, property) and not name.startswith("__"):
                overload_attribute(made, name, strict=False)(_chooser(one.fget))
            elif isinstance(one, bool):
                scope: dict[str, Any] = {}
                exec(f"def constant(one):\n    return {one}", scope)
                overload_attribute(made, name, strict=False)(lambda _one, f=scope["constant"]: f)
            elif isinstance(one, python_types.FunctionType) and not name.startswith("__"):
                overload_method(made, name, strict=False)(_chooser(one))

    def _chooser(function: Any) -> Any:
        @cache
        def copied() -> Any:
            return _raising(function) if function in RARE else scope_of(function, jitted)

        def choose(*_args: Any, **_kwargs: Any) -> Any:
            return copied()

        choose.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
        return choose

    def _raising(function: Any) -> Any:
        """What compiled code does instead of a rare function: it gives the tick back."""
        hint = get_type_hints(function).get("return")
        kind = None if hint in (None, type(None)) else _kind(hint)
        zero = _zero(types.none if kind is None else _numba_type(kind))
        names = function.__code__.co_varnames[: function.__code__.co_argcount]
        scope = {"zero": zero, "always": _always, "NotOrdinary": NotOrdinary}
        exec(
            f"def rare({', '.join(names)}):\n    if always():\n        raise NotOrdinary\n    return zero()",
            scope,
        )
        return scope["rare"]

    @intrinsic
    def _always(_typing: Any) -> Any:
        return types.boolean(), lambda *_: cgutils.true_bit

    @cache
    def _zero(kind: Any) -> Any:
        @intrinsic
        def zero(_typing: Any) -> Any:
            return kind(), lambda context, *_: context.get_constant_null(kind)

        return zero

    class _Address(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, ir.IntType(8).as_pointer())

    @infer_getattr
    class _Fields(AttributeTemplate):
        key = Held

        def generic_resolve(self, one: Held, name: str) -> Any:
            return one.type_of(name)

    def _place(builder: Any, one: Any, address: Any, name: str) -> Any:
        return cgutils.pointer_add(builder, address, _WORD * fields_of(one.cls)[name][1])

    _DOUBLE, _WHOLE = ir.DoubleType(), ir.IntType(64)

    def _load(context: Any, builder: Any, kind: Any, place: Any) -> tuple[Any, int]:
        """Value of a type, and the numbers that it takes."""
        if isinstance(kind, types.BaseTuple):
            items, at = [], 0
            for each in kind:
                item, size = _load(context, builder, each, cgutils.pointer_add(builder, place, _WORD * at))
                items.append(item)
                at += size
            return context.make_tuple(builder, kind, items), at
        if kind == types.none:
            return context.get_dummy_value(), 0
        if kind == types.float64:
            return builder.load(builder.bitcast(place, _DOUBLE.as_pointer())), 1
        number = builder.load(builder.bitcast(place, _WHOLE.as_pointer()))
        if kind == types.boolean:
            return builder.icmp_signed("!=", number, _WHOLE(0)), 1
        if isinstance(kind, Held):
            return builder.inttoptr(number, ir.IntType(8).as_pointer()), 1
        return number, 1

    def _store(context: Any, builder: Any, kind: Any, place: Any, value: Any) -> int:
        if isinstance(kind, types.BaseTuple):
            at = 0
            for n, each in enumerate(kind):
                to = cgutils.pointer_add(builder, place, _WORD * at)
                at += _store(context, builder, each, to, builder.extract_value(value, n))
            return at
        if kind == types.none:
            return 0
        if kind == types.float64:
            builder.store(value, builder.bitcast(place, _DOUBLE.as_pointer()))
            return 1
        if kind == types.boolean:
            value = builder.zext(value, _WHOLE)
        elif isinstance(kind, Held):
            value = builder.ptrtoint(value, _WHOLE)
        builder.store(value, builder.bitcast(place, _WHOLE.as_pointer()))
        return 1

    @lower_getattr_generic(Held)
    def _get(context: Any, builder: Any, one: Held, address: Any, name: str) -> Any:
        return _load(context, builder, one.type_of(name), _place(builder, one, address, name))[0]

    @lower_setattr_generic(Held)
    def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
        one = signature.args[0]
        _store(context, builder, one.type_of(name), _place(builder, one, args[0], name), args[1])

    @typeof_impl.register(Handle)
    def _type_of_handle(handle: Handle, _context: Any) -> Any:
        return handle.kind

    @unbox(Held)
    def _unbox(_kind: Any, handle: Any, c: Any) -> Any:
        number = c.pyapi.object_getattr_string(handle, "address")
        whole = c.pyapi.long_as_longlong(number)
        c.pyapi.decref(number)
        return NativeValue(c.builder.inttoptr(whole, ir.IntType(8).as_pointer()))

    _known: set[Any] = set()

    def _register_named() -> None:
        """Let compiled code use the methods of named tuples that are marked."""
        for cls in [each for each in MARKED if isinstance(each, type) and each not in _known]:
            _known.add(cls)
            for name, one in vars(cls).items():
                if isinstance(one, property):
                    overload_attribute(types.BaseNamedTuple, name, strict=False)(_of_class(cls, one.fget))
                elif isinstance(one, python_types.FunctionType) and not name.startswith("_"):
                    overload_method(types.BaseNamedTuple, name, strict=False)(_of_class(cls, one))

    def _of_class(cls: type, function: Any) -> Any:
        def choose(one: Any, *_args: Any, **_kwargs: Any) -> Any:
            return scope_of(function, jitted) if one.instance_class is cls else None

        choose.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
        return choose

    def kind_of(one: object) -> Any:
        """Type of an object for compiled code."""
        _register_named()
        fields = fields_of(_class(one))
        others = [(n, getattr(one, n)) for n, (kind, _) in fields.items() if kind.is_object]
        others = [(n, o) for n, o in others if o is not None]
        return _held(type(one), tuple((n, kind_of(o)) for n, o in others if _differs(type(one), n, o)))

    def _differs(cls: type, name: str, one: object) -> bool:
        return fields_of(cls)[name][0].hint is not type(one) or bool(kind_of(one).others)
