"""Many CDR messages of one type into numpy arrays at once.

A message whose only variable parts are strings has a fixed layout for given string lengths. The layout is
worked out from the message definition, once for each combination of lengths, and all messages that share it
are read as one array: thousands in milliseconds, where a generic decoder takes seconds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.reader.reader import LogError
from logs.schema.cdr import CDR_HEADER, CODES
from logs.schema.schemas import UnknownSchemaError, fields_of


@dataclass
class Layout:
    """Where each field of a message lies.

    Attributes:
        names: dotted field names, for example ``header.stamp.sec``.
        formats: numpy formats; an array has its length in front.
        offsets: bytes from the start of the payload, CDR header included.
        strings: for each string its name, offset of its length, and length with the final zero.
        size: bytes of the whole payload.
    """

    names: list[str] = field(default_factory=list)
    formats: list[str] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    strings: list[tuple[str, int, int]] = field(default_factory=list)
    size: int = len(CDR_HEADER)

    def dtype(self) -> np.dtype[np.void]:
        """Return the layout as a structured numpy type."""
        return np.dtype(
            {"names": self.names, "formats": self.formats, "offsets": self.offsets, "itemsize": self.size}
        )


def layout(schema: str, first: bytes) -> Layout:
    """Work out the layout of a message type, with string lengths taken from the example ``first``.

    Raises:
        LogError: the type is unknown, has sequences, or the example is not such a message.
    """
    if first[:4] != CDR_HEADER:
        raise LogError(f"{schema}: begins with {first[:4].hex(' ')}; only little-endian plain CDR is read")
    result = Layout()
    try:
        _walk(schema, "", first, result)
    except UnknownSchemaError as error:
        raise LogError(str(error)) from error
    except struct.error as error:
        raise LogError(f"{schema}: {len(first)} bytes are too short for this type") from error
    if result.size != len(first):
        raise LogError(f"{schema}: found {len(first)} bytes, its definition needs {result.size}")
    return result


@dataclass
class Columns:
    """Messages of one type, field by field.

    Attributes:
        rows: (m,) indices of the messages that could be read.
        numbers: arrays of shape (m,) or (m, k) by field name.
        texts: every string field, m texts each.
        problems: why each of the others could not be read.
    """

    rows: NDArray[np.intp]
    numbers: dict[str, NDArray[Any]]
    texts: dict[str, list[str]]
    problems: list[str]


def columns(schema: str, payloads: Sequence[bytes], wanted: Iterable[str]) -> Columns:
    """Decode messages of one type.

    Args:
        schema: full type name, for example ``nav_msgs/msg/Odometry``.
        payloads: the messages.
        wanted: field names; a nested message of numbers is stacked, so that a Vector3 gives (m, 3).

    Raises:
        LogError: none of the messages can be read, or a wanted name is not a field.
    """
    layouts: list[Layout] = []
    which = np.full(len(payloads), -1)
    problems: list[str] = []
    for index, data in enumerate(payloads):
        found = next((n for n, each in enumerate(layouts) if _fits(each, data)), -1)
        if found < 0:
            try:
                layouts.append(layout(schema, data))
            except LogError as error:
                problems.append(str(error))
                continue
            found = len(layouts) - 1
        which[index] = found
    rows = np.flatnonzero(which >= 0)
    if not len(rows):
        raise LogError(problems[0] if problems else f"{schema}: no messages")
    numbers: dict[str, NDArray[Any]] = {}
    texts: dict[str, list[str]] = {}
    for number, each in enumerate(layouts):
        members = np.flatnonzero(which[rows] == number)
        records = np.frombuffer(b"".join(payloads[i] for i in rows[members]), dtype=each.dtype())
        for name in wanted:
            block = _block(records, each, name, schema)
            if name not in numbers:
                numbers[name] = np.empty((len(rows), *block.shape[1:]), dtype=block.dtype)
            numbers[name][members] = block
        for name, at, length in each.strings:
            column = texts.setdefault(name, [""] * len(rows))
            for m in members:
                column[m] = payloads[rows[m]][at + 4 : at + 3 + length].decode(errors="replace")
    return Columns(rows, numbers, texts, problems)


def _fits(found: Layout, data: bytes) -> bool:
    if len(data) != found.size or data[:4] != CDR_HEADER:
        return False
    return all(int.from_bytes(data[at : at + 4], "little") == length for _, at, length in found.strings)


def _block(records: NDArray[Any], found: Layout, name: str, schema: str) -> NDArray[Any]:
    """One field, or the numbers of a nested message side by side."""
    if name in found.names:
        return np.ascontiguousarray(records[name])
    inner = [each for each in found.names if each.startswith(name + ".")]
    if not inner:
        raise LogError(f"{schema} has no field {name!r}; it has {', '.join(found.names)}")
    return np.stack([records[each] for each in inner], axis=1)


def _walk(schema: str, prefix: str, data: bytes, out: Layout) -> None:
    for field_ in fields_of(schema):
        name, kind, length = prefix + field_.name, field_.kind, field_.length
        if kind in CODES and length != 0:
            size = struct.calcsize("<" + CODES[kind])
            at = _aligned(out.size, size)
            out.names.append(name)
            out.formats.append(f"{length or ''}<{CODES[kind]}")
            out.offsets.append(at)
            out.size = at + size * (length or 1)
        elif kind == "string" and length is None:
            at = _aligned(out.size, 4)
            (size,) = struct.unpack_from("<I", data, at)
            out.strings.append((name, at, size))
            out.size = at + 4 + size
        elif length is None:
            _walk(kind, name + ".", data, out)
        else:
            raise LogError(f"field {name} has no fixed size; this type is not for bulk decoding")


def _aligned(at: int, size: int) -> int:
    """Next multiple of ``size``, counted from the end of the CDR header."""
    body = at - len(CDR_HEADER)
    return len(CDR_HEADER) + body + (-body % size)
