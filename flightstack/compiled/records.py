"""Flat, typed records: one block of memory that compiled and plain Python code both read and write.

A record is declared as a class with annotations, which is all that the type checker needs; ``new`` makes a
zeroed numpy record of the same fields. Fields are ``float``, ``int``, ``bool``, other records, and arrays,
written ``Annotated[F64, length]`` for doubles and ``Annotated[I64, length]`` for whole numbers. A nested
record is a view: what it holds stands in the outer one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable
from functools import cache, partial
from typing import Annotated, Any, Protocol, TypeVar, cast, get_args, get_origin, get_type_hints, overload

import numpy as np
import numpy.typing as npt

from flightstack.compiled.jit import is_off

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Vector = Annotated[F64, 3]
Quaternion = Annotated[F64, 4]  # w, x, y, z
Motors = Annotated[F64, 4]  # M1..M4
Axes = Annotated[F64, 9]  # body x, y and z axis in the world

SCALARS: dict[object, str] = {float: "f8", int: "i8", bool: "i8"}  # all of 8 bytes: no gaps


class Record:
    """Base of the declarations; never made itself."""


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
    """Memory layout of a declared record.

    Raises TypeError: a field of a kind that records cannot hold; AttributeError: a field that has the name of
    a method of numpy's records.
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
    """Make a record, zeroed or with ``values`` in the order of its fields."""
    array = np.zeros(1, layout(cast("Hashable", declaration)))
    if values is not None:
        array[0] = values
    return cast(R, array[0])


class Cell(Protocol[R_co]):
    """A record as an array of one element, as compiled code takes it."""

    @overload
    def __getitem__(self, key: int) -> R_co: ...
    @overload
    def __getitem__(self, key: str) -> npt.NDArray[Any]: ...
    def __setitem__(self, key: int, values: tuple[object, ...]) -> None:
        """Set all fields, in their order."""


def cell(record: R) -> Cell[R]:
    """View of a record for hot code: numba takes it in 0.3 us, the record itself in up to 20 us.

    ``cell(record)["name"]`` is a view of the field with one element more in front.
    """
    return cast("Cell[R]", np.asarray(cast(np.record, record)).reshape(1))


def cell_of_numbers(record: R) -> Cell[R]:
    """``cell`` for code that takes single numbers out and no slices: as quick when it is not compiled.

    Plain Python then gets the fields by ctypes, in the same memory: 0.1 us each, where numpy's take 3.
    """
    one = cell(record)
    if not is_off():
        return one
    array = cast("npt.NDArray[np.void]", one)
    return cast("Cell[R]", (np.ctypeslib.as_ctypes_type(_bare(array.dtype)).from_buffer(array),))


def _bare(kind: np.dtype[Any]) -> np.dtype[Any]:
    """The same layout without numpy's record type, which ctypes does not know."""
    if kind.names is None:
        return kind
    formats = [_bare(kind[name]) for name in kind.names]
    return np.dtype({"names": kind.names, "formats": formats})


Scalar = Any  # a memoryview of one number, which is Python's own when it is taken out
Values = tuple[Any, ...]


def scalars(record: Record, *names: str) -> list[Scalar]:
    """Views of scalar fields: ``view[0]`` reads and writes one, at a third of the cost of numpy's."""
    view = cell(record)
    return [view[name].data for name in names]


def reader(source: Record | F64, skipping: str = "") -> Callable[[], Values]:
    """Function that returns all numbers of a record, or array, in one flat tuple.

    A slice of it is a tuple too: so a record is read at a fifth of what its fields one by one would cost.

    ``source``: what is read; ``skipping``: field of the record that is left out.
    """
    array = np.asarray(cast(np.record, source)).reshape(-1)
    if array.dtype.names is None:
        return partial(struct.Struct(f"={array.size}d").unpack_from, array.data)
    memory = array.view(np.uint8).data
    return partial(struct.Struct("=" + _format(array.dtype, skipping)).unpack_from, memory)


def writer(record: Record) -> Callable[..., None]:
    """Function that sets all numbers of a record, given one by one: a quarter of numpy's cost."""
    array = np.asarray(cast(np.record, record)).reshape(1)
    return partial(struct.Struct("=" + _format(array.dtype)).pack_into, array.view(np.uint8).data, 0)


@cache
def _format(kind: np.dtype[Any], skipping: str = "") -> str:
    if kind.names is not None:
        return "".join(
            f"{kind[name].itemsize}x" if name == skipping else _format(kind[name]) for name in kind.names
        )
    count = int(np.prod(kind.shape))
    return f"{count}{'d' if kind.base == np.float64 else 'q'}"
