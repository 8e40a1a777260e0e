"""Compiled forms of the core's objects; they are generated from the annotations of the classes.

Compiled code gets the address of an object, and reads and writes the object's annotated fields: numbers,
tuples of numbers, named tuples, texts (as numbers), and other objects. The code also calls the compiled
methods of the object's class. Compiled code cannot access fields of other kinds; no field contains ``None``.
Dataclasses that are not frozen contain the state: ``Objects.write`` copies the state from Python's objects
and ``Objects.read`` copies it back. All other objects are copied once.
"""

from __future__ import annotations

import inspect
import struct
import types as python_types
from collections.abc import Iterator
from functools import cache
from itertools import accumulate
from typing import TYPE_CHECKING, Any, get_origin, get_type_hints

import numpy as np

from flightstack.compiled.jit import is_off, jitted, load_numba
from flightstack.compiled.layout import (
    WORD,
    Kind,
    class_of,
    fields_of,
    is_enum,
    is_state,
    kind_of_hint,
    objects_of,
    reader_of,
    struct_of,
    taker_of,
)
from flightstack.core.numeric import MARKED, RARE, STAND_INS, NotOrdinary, scope_of


class Objects:
    """An object, and all objects that its fields refer to, in memory that compiled code can use.

    As an argument of compiled code, ``Objects(root)`` represents the object ``root``.
    """

    def __init__(self, root: object) -> None:
        found = sorted(_reached(root, {}), key=lambda one: not is_state(class_of(one)))  # state objects first
        self._state = [one for one in found if is_state(class_of(one))]
        ends = list(accumulate((struct_of(class_of(one)).size for one in found), initial=0))
        words = np.zeros(ends[-1] // WORD + 1)
        self.state, self._memory = words[: ends[len(self._state)] // WORD], words.data
        self.spare, begin = np.zeros_like(self.state), words.ctypes.data
        self._places = {id(one): place for one, place in zip(found, ends, strict=False)}
        self._at = {one: begin + place for one, place in self._places.items()}
        for one in found[len(self._state) :]:
            self.write_one(one)
        self.kind, self.address = kind_of(root), self._at[id(root)]  # type and address for compiled code

    def write(self) -> bool:
        """Copy the state from Python's objects; return False if one of the fields is ``None``."""
        try:
            for one in self._state:
                self.write_one(one)
        except (TypeError, struct.error):
            return False
        return True

    def write_one(self, one: object) -> None:
        """Copy the fields of one object from Python to compiled memory."""
        struct_of(class_of(one)).pack_into(self._memory, self._places[id(one)], *self.numbers(one))

    def numbers(self, one: object) -> tuple[Any, ...]:
        """Return the elements of an object in the order of compiled memory."""
        return taker_of(class_of(one))(one, self._at)

    def read(self) -> None:
        """Copy the state from compiled memory to Python's objects."""
        for one in self._state:
            self.read_one(one)

    def read_one(self, one: object) -> None:
        """Copy the fields of one object from compiled memory to Python."""
        cls = class_of(one)
        reader_of(cls)(one, struct_of(cls).unpack_from(self._memory, self._places[id(one)]))


def _reached(one: Any, known: dict[int, Any]) -> Iterator[Any]:
    """Yield an object and all objects to which its fields refer, each once."""
    if id(one) in known:
        return
    known[id(one)] = one
    yield one
    for name in objects_of(class_of(one)):
        if (part := getattr(one, name)) is not None:
            yield from _reached(part, known)


if TYPE_CHECKING or is_off():
    kind_of = type  # without numba no code is compiled
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
        """Type of an object that compiled code accesses by its address."""

        def __init__(self, cls: type, others: tuple[tuple[str, Any], ...]) -> None:
            self.cls, self.others = cls, dict(others)
            super().__init__(name=f"{cls.__module__}.{cls.__qualname__}{list(others) or ''}")

        def __reduce__(self) -> Any:
            return _held, (self.cls, tuple(self.others.items()))

        def type_of(self, name: str) -> Any:
            """Return the type of a field; None if no field has this name."""
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
        if kind.hint is bool:
            return types.boolean
        if kind.hint is float:
            return types.float64
        if is_enum(kind.hint):
            return types.IntEnumMember(kind.hint, types.int64)
        return types.int64 if kind.hint in (int, str) else _held(kind.hint, ())

    @cache  # each new type would hash its long name in each call of compiled code
    def _held(cls: type, others: tuple[tuple[str, Any], ...]) -> Held:
        return _class_of(cls)(cls, others)

    @cache
    def _class_of(cls: type) -> type[Held]:
        """Return a numba type for the objects of a class; the type has the methods of the class."""
        made = type(cls.__name__, (Held,), {})
        register_default(made)(_Address)
        _register(made, cls)
        return made

    def _register(made: Any, cls: type) -> None:
        for name in dir(cls):
            one = getattr(cls, name)
            if name.startswith("__") or name in fields_of(cls):  # a property can have a field's name
                continue
            if isinstance(one, property):
                overload_attribute(made, name, strict=False)(_chooser(one.fget))
            elif isinstance(one, bool):
                overload_attribute(made, name, strict=False)(lambda _one, one=one: lambda _one: one)
            elif isinstance(one, python_types.FunctionType):
                overload_method(made, name, strict=False)(_chooser(STAND_INS.get(one, one)))

    def _chooser(function: Any, cls: type | None = None) -> Any:
        """Return the overload of a method for numba; ``cls``: class that it is limited to; None: no limit."""

        @cache
        def copied() -> Any:
            return _refusing(function) if function in RARE else scope_of(function, jitted)

        def choose(one: Any, *_args: Any, **_kwargs: Any) -> Any:
            return copied() if cls is None or one.instance_class is cls else None

        choose.__signature__ = inspect.signature(function)  # type: ignore[attr-defined]
        return choose

    def _refusing(function: Any) -> Any:
        """Return the compiled form of a rare function: it raises ``NotOrdinary``; Python runs the tick."""
        kind = kind_of_hint(get_type_hints(function)["return"])
        result = types.none if kind is None else _numba_type(kind)

        @intrinsic
        def refuse(_typing: Any) -> Any:
            def code(context: Any, builder: Any, *_: Any) -> Any:
                with builder.if_then(cgutils.true_bit):
                    context.call_conv.return_user_exc(builder, NotOrdinary, ())
                return context.get_constant_null(result)

            return result(), code

        names, scope = ", ".join(inspect.signature(function).parameters), {"refuse": refuse}
        exec(f"def rare({names}):\n    return refuse()", scope)
        return scope["rare"]

    class _Address(models.PrimitiveModel):
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, ir.IntType(8).as_pointer())

    @infer_getattr
    class _Fields(AttributeTemplate):
        key = Held

        def generic_resolve(self, one: Held, name: str) -> Any:
            return one.type_of(name)

    def _place(context: Any, builder: Any, one: Held, address: Any, name: str) -> Any:
        """Return a pointer to a field; a boolean uses the first of its 8 bytes, and the others are zero."""
        place = cgutils.pointer_add(builder, address, WORD * fields_of(one.cls)[name][1])
        return builder.bitcast(place, context.get_data_type(one.type_of(name)).as_pointer())

    @lower_getattr_generic(Held)
    def _get(context: Any, builder: Any, one: Held, address: Any, name: str) -> Any:
        kind = one.type_of(name)
        return context.unpack_value(builder, kind, _place(context, builder, one, address, name))

    @lower_setattr_generic(Held)
    def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
        one = signature.args[0]
        context.pack_value(builder, one.type_of(name), args[1], _place(context, builder, one, args[0], name))

    @typeof_impl.register(Objects)
    def _type_of(objects: Objects, _context: Any) -> Any:
        return objects.kind

    @unbox(Held)
    def _unbox(_kind: Any, objects: Any, c: Any) -> Any:
        number = c.pyapi.object_getattr_string(objects, "address")
        whole = c.pyapi.long_as_longlong(number)
        c.pyapi.decref(number)
        return NativeValue(c.builder.inttoptr(whole, ir.IntType(8).as_pointer()))

    @cache
    def _register_named(cls: type) -> None:
        """Register the methods of a named tuple for compiled code."""
        for name, one in vars(cls).items():
            if isinstance(one, property):
                overload_attribute(types.BaseNamedTuple, name, strict=False)(_chooser(one.fget, cls))
            elif isinstance(one, python_types.FunctionType) and not name.startswith("_"):
                overload_method(types.BaseNamedTuple, name, strict=False)(_chooser(one, cls))

    def kind_of(one: object) -> Any:
        """Return the type of an object for compiled code."""
        for cls in MARKED:
            _register_named(cls)
        return _kind(one, {})

    def _kind(one: object, known: dict[int, Held]) -> Held:
        """Return the type of an object; ``known``: types of the objects found so far, by id."""
        if id(one) not in known:
            cls, others = class_of(one), []
            for name, hint in objects_of(cls).items():
                if (part := getattr(one, name)) is not None:
                    found = _kind(part, known)
                    if found.cls is not hint or found.others:
                        others.append((name, found))
            known[id(one)] = _held(cls, tuple(others))
        return known[id(one)]
