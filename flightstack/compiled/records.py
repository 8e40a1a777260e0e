"""Flat, typed records: blocks of memory that compiled code and plain Python both read and write.

A record is declared as a class with annotations for the type checker; ``new`` makes a zeroed numpy record
with the same fields. Fields are ``float``, ``int``, ``bool``, other records, and arrays, written
``Annotated[F64, length]`` for doubles and ``Annotated[I64, length]`` for whole numbers. A nested record is a
view into the memory of the outer one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable
from functools import cache, partial
from typing import Annotated, Any, Protocol, TypeVar, cast, get_args, get_origin, get_type_hints, overload

import numpy as np
import numpy.typing as npt

from flightstack.compiled.jit import is_off, jitted

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Vector = Annotated[F64, 3]
Quaternion = Annotated[F64, 4]  # components w, x, y, z
Motors = Annotated[F64, 4]  # values of the motors M1 to M4
Axes = Annotated[F64, 9]  # x, y and z axis of the body in the world

SCALARS: dict[object, str] = {float: "f8", int: "i8", bool: "i8"}  # numpy types, all of 8 bytes: no gaps


class Record:
    """Base class of the declarations; it has no instances."""


R = TypeVar("R", bound=Record)
R_co = TypeVar("R_co", bound=Record, covariant=True)


def _field(hint: Any) -> object:
    if get_origin(hint) is Annotated:
        array, length = get_args(hint)
        return ("i8" if array == I64 else "f8", (length,))
    if hint in SCALARS:
        return SCALARS[hint]
    if isinstance(hint, type) and issubclass(hint, Record):
        return layout(cast("Hashable", hint))
    raise TypeError(f"record field: found {hint}, allowed are float, int, bool, arrays and records")


@cache
def layout(declaration: type[Record]) -> np.dtype[np.void]:
    """Return the memory layout of a declared record.

    Raises TypeError: records cannot hold a field of this kind; AttributeError: a field has the name of a
    method of numpy's records.
    """
    hints = get_type_hints(declaration, include_extras=True)
    fields: list[Any] = []
    for name, hint in hints.items():
        if hasattr(np.record, name):
            raise AttributeError(f"{declaration.__name__}.{name}: numpy.record has that already; rename it")
        kind: Any = _field(hint)
        fields.append((name, *kind) if isinstance(kind, tuple) else (name, kind))
    return np.dtype((np.record, np.dtype(fields)))


def new(declaration: type[R], values: tuple[object, ...] | None = None) -> R:
    """Return a new record, zeroed or with ``values`` in the order of its fields."""
    array = np.zeros(1, layout(cast("Hashable", declaration)))
    if values is not None:
        array[0] = values
    return cast(R, array[0])


class Cell(Protocol[R_co]):
    """A record as an array of one element: the form in which compiled code receives it."""

    @overload
    def __getitem__(self, key: int) -> R_co: ...
    @overload
    def __getitem__(self, key: str) -> npt.NDArray[Any]: ...
    def __setitem__(self, key: int, values: tuple[object, ...]) -> None:
        """Set all fields, in their order."""


def cell(record: R) -> Cell[R]:
    """Return a view for fast calls: numba accepts the view in 0.3 us, and the record itself in up to 20 us.

    ``cell(record)["name"]`` is a view of the field with an additional first dimension of one element.
    """
    return cast("Cell[R]", np.asarray(cast(np.record, record)).reshape(1))


def cell_of_numbers(record: R) -> Cell[R]:
    """Return a cell for code that reads single numbers, but no slices; the cell is fast in plain Python, too.

    In plain Python, ctypes reads the fields from the same memory, in 0.1 us each instead of numpy's 3 us.
    """
    one = cell(record)
    if not is_off():
        return one
    array = cast("npt.NDArray[np.void]", one)
    return cast("Cell[R]", (np.ctypeslib.as_ctypes_type(_bare(array.dtype)).from_buffer(array),))


def _bare(kind: np.dtype[Any]) -> np.dtype[Any]:
    """Return a layout without numpy's record type, which ctypes does not support."""
    if kind.names is None:
        return kind
    formats = [_bare(kind[name]) for name in kind.names]
    return np.dtype({"names": kind.names, "formats": formats})


@jitted
def copy(source: F64, target: F64) -> None:
    """Copy element by element: numba needs 2 s to compile ``target[:] = source``."""
    for i in range(len(target)):
        target[i] = source[i]


Scalar = Any  # a memoryview of one number; reading it returns a Python number
Values = tuple[Any, ...]


def scalars(record: Record, *names: str) -> list[Scalar]:
    """Return views of scalar fields: ``view[0]`` reads or writes the field in a third of numpy's time."""
    view = cell(record)
    return [view[name].data for name in names]


def reader(source: Record | F64) -> Callable[[], Values]:
    """Return a function that returns all elements of a record or array in one flat tuple.

    Slices of this tuple give the fields in a fifth of the time of single reads.
    """
    array = np.asarray(cast(np.record, source)).reshape(-1)
    memory = array.view(np.uint8).data
    return partial(struct.Struct(f"={_format(array.dtype) * array.size}").unpack_from, memory)


def writer(record: Record) -> Callable[..., None]:
    """Return a function that sets a record's elements from as many arguments, 4 times as fast as numpy."""
    array = np.asarray(cast(np.record, record)).reshape(1)
    return partial(struct.Struct("=" + _format(array.dtype)).pack_into, array.view(np.uint8).data, 0)


@cache
def _format(kind: np.dtype[Any]) -> str:
    if kind.names is not None:
        return "".join(_format(kind[name]) for name in kind.names)
    return ("d" if kind.base == np.float64 else "q") * int(np.prod(kind.shape))
