"""Objects of the core in compiled code, generated from the annotations of their classes.

Compiled code gets the address of an object, and reads and writes its annotated fields there: numbers, tuples
of numbers, named tuples, texts (as numbers), and other objects. It calls compiled forms of the methods of the
object's class. Fields of any other kind do not exist for compiled code; a field that may be ``None`` is never
``None`` there. Dataclasses that are not frozen are state: ``Objects.write`` copies it from Python's objects
and ``Objects.read`` copies it back. Everything else is copied once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from flightstack.compiled.held import Handle, kind_of
from flightstack.compiled.jit import is_off
from flightstack.compiled.layout import WORD, class_of, fields_of, format_of, is_state, reader_of, taker_of


class Objects:
    """An object, and all objects that its fields refer to, in memory that compiled code can use."""

    def __init__(self, root: object) -> None:
        found = list(_reached(root, {}))
        self._state = [one for one in found if is_state(class_of(one))]
        others = [one for one in found if not is_state(class_of(one))]
        self.state, self.spare, self._constant = (
            np.zeros(sum(len(format_of(class_of(one))) for one in some) + 1)
            for some in (self._state, self._state, others)
        )
        self._at: dict[int, int] = {}
        for some, memory in ((self._state, self.state), (others, self._constant)):
            at = memory.ctypes.data
            for one in some:
                self._at[id(one)] = at
                at += WORD * len(format_of(class_of(one)))
        whole = "".join(format_of(class_of(one)) for one in others)
        numbers = [number for one in others for number in taker_of(class_of(one))(one, self._at)]
        struct.pack_into(f"={whole}", self._constant.data, 0, *numbers)
        self._struct = struct.Struct("=" + "".join(format_of(class_of(one)) for one in self._state))
        self._takers = [(one, taker_of(class_of(one))) for one in self._state]
        ends = accumulate(len(format_of(class_of(one))) for one in self._state)
        self._readers = [
            (one, reader_of(class_of(one)), slice(begin, end))
            for one, (begin, end) in zip(self._state, pairwise((0, *ends)), strict=True)
        ]
        self._root = root

    @property
    def handle(self) -> Handle:
        """The object as an argument of compiled code; it does not change."""
        return Handle(None if is_off() else kind_of(self._root), self._at[id(self._root)])

    def write(self) -> bool:
        """Copy the state from Python's objects; return False if one of the fields is ``None``."""
        numbers: list[Any] = []
        try:
            for one, take in self._takers:
                numbers += take(one, self._at)
            self._struct.pack_into(self.state.data, 0, *numbers)
        except (TypeError, struct.error):
            return False
        return True

    def numbers(self, one: object) -> tuple[Any, ...]:
        """Return the numbers of an object in the order of compiled memory."""
        return taker_of(class_of(one))(one, self._at)

    def write_one(self, one: object) -> None:
        """Copy the state of one object from Python."""
        at = (self._at[id(one)] - self.state.ctypes.data) // WORD
        struct.pack_into(f"={format_of(class_of(one))}", self.state.data, at * WORD, *self.numbers(one))

    def read(self) -> None:
        """Copy the state back to Python's objects."""
        numbers = self._struct.unpack_from(self.state.data)
        for one, read, part in self._readers:
            read(one, numbers[part])


def _reached(one: Any, known: dict[int, Any]) -> Iterator[Any]:
    """Yield all objects to which fields refer, each once."""
    if id(one) in known:
        return
    known[id(one)] = one
    yield one
    for name, (kind, _) in fields_of(class_of(one)).items():
        if kind.is_object and getattr(one, name) is not None:
            yield from _reached(getattr(one, name), known)
