"""Recorded against replayed, bit by bit: NaN equals a NaN of the same bits, 0.0 does not equal -0.0."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from logs.schema import schemas
from logs.schema.cdr import CDR_HEADER, CODES

SHOWN_MAX = 10  # differences kept; the others are counted
_F64 = struct.Struct("<d")


@dataclass(frozen=True, slots=True)
class TickDifference:
    """One value that differs."""

    topic: str  # topic of the recorded value
    tick: int  # tick number
    field: str  # dotted name as in the message definition
    recorded: str  # value in the log, as text
    replayed: str  # value of this replay, as text

    def __str__(self) -> str:
        return (
            f"{self.topic} tick {self.tick} {self.field}: recorded {self.recorded}, replayed {self.replayed}"
        )


@dataclass
class Tally:
    """Differences of one kind: their number, and the first ones."""

    count: int = 0
    ticks: int = 0  # that hold one
    first: list[TickDifference] = field(default_factory=list)

    def add(self, found: Iterable[TickDifference]) -> None:
        before = self.count
        for each in found:
            self.count += 1
            if len(self.first) < SHOWN_MAX:
                self.first.append(each)
        self.ticks += self.count > before


def places_of(schema: str, example: bytes) -> list[tuple[str, str, int, int]]:
    """Return where the fields of a message lie: dotted name, ``struct`` code, first byte, byte behind."""
    places: list[tuple[str, str, int, int]] = []

    def walk(inner: str, prefix: str, at: int) -> int:
        for each in schemas.fields_of(inner):
            name, code = prefix + each.name, "s" if each.kind == "string" else CODES.get(each.kind, "")
            if not code:
                at = walk(each.kind, name + ".", at)
                continue
            size = 4 if code == "s" else struct.calcsize("<" + code)  # a string begins with its length
            at += (len(CDR_HEADER) - at) % size
            end = at + size + (int.from_bytes(example[at : at + 4], "little") if code == "s" else 0)
            places.append((name, code, at, end))
            at = end
        return at

    walk(schema, "", len(CDR_HEADER))
    return places


def fields_of(schema: str, recorded: bytes, replayed: bytes) -> Iterator[tuple[str, str, str]]:
    """Yield (field, recorded, replayed) of every field whose bytes differ."""
    if recorded == replayed:
        return
    if len(recorded) != len(replayed):
        yield "size", f"{len(recorded)} bytes", f"{len(replayed)} bytes"
        return
    other = set(range(len(replayed)))
    for name, code, at, end in places_of(schema, replayed):
        other.difference_update(range(at, end))
        a, b = recorded[at:end], replayed[at:end]
        if a != b:
            yield name, *((repr(a[4:]), repr(b[4:])) if code == "s" else _texts(a, b, code))
    for at in sorted(other):
        if recorded[at] != replayed[at]:
            yield f"byte {at}", f"{recorded[at]:#04x}", f"{replayed[at]:#04x}"


def _texts(recorded: bytes, replayed: bytes, code: str) -> tuple[str, str]:
    """Both as numbers; as bytes where the numbers look alike."""
    a, b = (str(struct.unpack("<" + code, raw)[0]) for raw in (recorded, replayed))
    return (a, b) if a != b else (f"{a} (bytes {recorded.hex()})", f"{b} (bytes {replayed.hex()})")


def values_of(recorded: Any, replayed: Any, name: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield (field, recorded, replayed) for each difference of two dataclasses, tuples or plain values."""
    if type(recorded) is not type(replayed):
        yield name, repr(recorded), repr(replayed)
    elif dataclasses.is_dataclass(recorded) and not isinstance(recorded, type):
        for each in dataclasses.fields(recorded):
            inner = f"{name}.{each.name}" if name else each.name
            yield from values_of(getattr(recorded, each.name), getattr(replayed, each.name), inner)
    elif isinstance(recorded, tuple | list):
        if len(recorded) != len(replayed):
            yield f"{name}.length", str(len(recorded)), str(len(replayed))
        names = getattr(recorded, "_fields", None)
        for n, (a, b) in enumerate(zip(recorded, replayed, strict=False)):
            inner = f"{name}[{n}]" if not names else f"{name}.{names[n]}" if name else names[n]
            yield from values_of(a, b, inner)
    elif isinstance(recorded, float):
        a, b = _F64.pack(recorded), _F64.pack(replayed)
        if a != b:
            yield name, *_texts(a, b, "d")
    elif isinstance(recorded, Enum):
        if recorded is not replayed:
            yield name, recorded.name, replayed.name
    elif recorded != replayed:
        yield name, repr(recorded), repr(replayed)
