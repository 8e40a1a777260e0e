"""Generates functions that encode and decode CDR from message definitions.

A ROS 2 message is sent as a four-byte header and the fields in order, each aligned to its size. Consecutive
numbers are one ``struct`` call; strings and sequences separate such runs. The functions are generated as
source text, as ``collections.namedtuple`` generates its classes: a codec that reads the definition for each
message takes ten times as long. Tests compare the bytes with those of ``rosbags``.

The value of a message is the tuple of the values of its fields, in order:

=====================================  ================================================================
field                                  value
=====================================  ================================================================
``std_msgs/Header``                    the stamp, integer nanoseconds, if ``codec`` has a ``frame_id``; else
                                       (stamp, frame)
``Time``, ``Duration``                 integer nanoseconds
number, bool, string                   int, float, bool, str
array of fixed length                  tuple
message                                tuple: a Vector3 is (x, y, z)
sequence of numbers or of Vector3      the little-endian bytes of its elements
sequence of other messages             tuple of tuples
=====================================  ================================================================
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from itertools import count, islice
from typing import Any, NamedTuple

CDR_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian, no options (OMG DDSI-RTPS 10.5)
SEPARATOR = "=" * 80  # line between two definitions of a ros2msg text
MAP = "map"  # world frame of every message of this stack
HEADER_TYPE = "std_msgs/msg/Header"
TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_NS = 1_000_000_000  # nanoseconds per second
_ALIGNMENT_MAX = 8  # size of the largest number, bytes

_FIELD = re.compile(r"(?P<kind>[\w/]+)(\[(?P<bound><=)?(?P<count>\d*)\])? +(?P<name>[a-z]\w*) *(#.*)?")

Pack = Callable[[Sequence[Any]], bytes]
Unpack = Callable[[bytes], Any]


class Field(NamedTuple):
    name: str
    kind: str  # "float64", "string", or the full name of a message type
    length: int | None  # number of elements of an array; 0: a sequence; None: a single value


def fields_of_text(text: str) -> tuple[Field, ...]:
    """Return the fields of a message definition, in order."""
    found = [match for line in text.splitlines() if (match := _FIELD.fullmatch(line.rstrip()))]
    return tuple(Field(m["name"], _full(m["kind"]), _length(m["bound"], m["count"])) for m in found)


def split(text: str) -> dict[str, str]:
    """Return the definitions in a ros2msg text that follow a separator, by the full name of their type."""
    _, *parts = text.split(SEPARATOR)
    pairs = (part.strip().removeprefix("MSG: ").partition("\n") for part in parts)
    return {_full(name): body for name, _, body in pairs}


@cache
def standard_types() -> dict[str, tuple[Field, ...]]:
    """Return the fields of the types in ``standard.msg``; no process loads a complete type store for them."""
    text = files("bridge.ros2").joinpath("standard.msg").read_text(encoding="ascii")
    return {name: fields_of_text(body) for name, body in split(text).items()}


def standard(schema: str) -> tuple[Field, ...] | None:
    """Return the fields of a standard ROS 2 type, or None if ``standard.msg`` does not have it."""
    return standard_types().get(schema)


def _full(kind: str) -> str:
    """Convert a short type name into the full one: ``std_msgs/Header`` into ``std_msgs/msg/Header``."""
    package, separator, name = kind.partition("/")
    return f"{package}/msg/{name}" if separator else kind


def _length(bound: str | None, count: str | None) -> int | None:
    if count is None:
        return None
    return 0 if bound or not count else int(count)


def codec(
    schema: str,
    frame_id: str | None = MAP,
    make: Callable[[tuple[Any, ...]], Any] = tuple,
    fields: Callable[[str], tuple[Field, ...] | None] = standard,
    *,
    foreign: bool = False,
) -> tuple[Pack, Unpack]:
    """Return the functions that encode the value of a message as CDR, and decode it.

    The encoder raises struct.error if a number is outside the range of its field. The decoder raises
    ValueError if a payload is cut short, too long, or has a wrong encoding or frame. With ``frame_id``
    None each message has its own frame. ``fields`` returns the fields of a type. ``foreign``: payloads come
    from other programs and may have bytes after the message.
    """
    generator = _Generator(frame_id, fields)
    value = generator.message(schema, "row")
    generator.flush()
    source = [
        "def pack(row):",
        "    out = bytearray()",
        *generator.pack,
        "    return bytes(out)",
        "def unpack(data):",
        "    at = 0",
        "    try:",
        *("    " + line for line in generator.unpack),
        f"        if at != len(data) and not {foreign}:",
        "            raise ValueError(f'{len(data)} bytes, of which the last {len(data) - at} mean nothing')",
        "    except (ValueError, error) as problem:",
        f"        text = f'not a {schema}{'' if foreign else ' of this stack'}: {{problem}}; "
        "it begins with {data[:20].hex()}'",
        "        raise ValueError(text) from problem",
        f"    return make({value})",
    ]
    scope = generator.layouts | {"NS": _NS, "CDR": CDR_HEADER, "error": struct.error, "make": make}
    scope |= {"bytes_at": _bytes_at, "refuse": _refuse}
    exec("\n".join(source), scope)
    return scope["pack"], scope["unpack"]


class _Generator:
    """Generates the source text of encoder and decoder.

    A method that adds a field takes the expression of the field's value in the encoder, and returns the
    expression of the field's value in the decoder.
    """

    def __init__(self, frame_id: str | None, fields: Callable[[str], tuple[Field, ...] | None]) -> None:
        self._fields_of = fields
        self._frame = None if frame_id is None else frame_id.encode() + b"\x00"
        self.pack: list[str] = []
        self.unpack: list[str] = []
        self.layouts: dict[str, Any] = {}
        self._indent = "    "
        self._names = map("v{}".format, count())
        # Current run of numbers: struct codes, expressions to encode, names after decoding, and their checks.
        self._codes, self._given, self._taken = ["4s"], ["CDR"], ["cdr"]
        self._checks = ["if cdr != CDR: refuse('encoding', cdr, CDR)"]

    def message(self, schema: str, value: str) -> str:
        fields = self._fields_of(schema)
        if fields is None:
            raise TypeError(f"unknown message type {schema!r}")
        parts = [self._field(field, f"{value}[{n}]") for n, field in enumerate(fields)]
        return f"({', '.join(parts)},)" if parts else "()"

    def flush(self) -> None:
        """Generate the code of the current run of numbers, and end the run."""
        if self._codes:
            name = f"LAYOUT{len(self.layouts)}"
            self.layouts[name] = [_layout(self._codes, at) for at in range(_ALIGNMENT_MAX)]
            self._add(self.pack, f"out += {name}[len(out) % {_ALIGNMENT_MAX}].pack({', '.join(self._given)})")
            self._add(
                self.unpack,
                f"layout = {name}[at % {_ALIGNMENT_MAX}]",
                f"({', '.join(self._taken)},) = layout.unpack_from(data, at)",
                "at += layout.size",
                *self._checks,
            )
        self._codes, self._given, self._taken, self._checks = [], [], [], []

    def _field(self, field: Field, value: str) -> str:
        kind, number = field.kind, field.kind in CODES
        if field.length == 0:
            return self._sequence(kind, value)
        if kind == HEADER_TYPE:
            return self._header(value)
        if kind in TIME_TYPES:
            return self._time(value)
        if kind == "string":
            return self._string(value)
        if number and field.length is None:
            return self._run([CODES[kind]], value)[0]
        codes = self._numbers(kind)
        if not codes:
            return self.message(kind, value)
        return f"({', '.join(self._run(codes * (field.length or 1), f'*{value}'))},)"

    def _numbers(self, kind: str) -> list[str]:
        """Return the struct codes of a number or of a message of numbers of one type; else an empty list."""
        if kind in CODES:
            return [CODES[kind]]
        fields = (kind != "string" and self._fields_of(kind)) or ()
        codes = [CODES.get(field.kind, "") if field.length is None else "" for field in fields]
        return codes if len(set(codes)) == 1 and codes[0] else []

    def _header(self, value: str) -> str:
        if self._frame is None:
            return f"({self._time(f'{value}[0]')}, {self._string(f'{value}[1]')})"
        stamp, length = self._time(value), len(self._frame)
        size, frame = self._run(["I", f"{length}s"], str(length), repr(self._frame))
        wrong = f"{size} != {length} or {frame} != {self._frame!r}"
        self._checks.append(f"if {wrong}: refuse('frame', {frame}, {self._frame!r})")
        return stamp

    def _time(self, value: str) -> str:
        seconds, nanoseconds = self._run(["i", "I"], f"{value} // NS", f"{value} % NS")
        return f"{seconds} * NS + {nanoseconds}"

    def _string(self, value: str) -> str:
        raw = next(self._names)
        self._add(self.pack, f"{raw} = {value}.encode() + b'\\0'")
        (size,) = self._run(["I"], f"len({raw})")
        self.flush()
        self._add(self.pack, f"out += {raw}")
        self._add(self.unpack, f"{raw} = bytes_at(data, at, {size}).removesuffix(b'\\0').decode()")
        self._add(self.unpack, f"at += {size}")
        return raw

    def _sequence(self, kind: str, value: str) -> str:
        made, numbers = next(self._names), self._numbers(kind)
        size = struct.calcsize("<" + "".join(numbers))
        (length,) = self._run(["I"], f"len({value}) // {size}" if numbers else f"len({value})")
        self.flush()
        if numbers:
            align = struct.calcsize("<" + numbers[0])  # an empty sequence has no padding
            self._add(self.pack, f"out += bytes((4 - len(out)) % {align}) + {value} if {value} else b''")
            self._add(self.unpack, f"at += (4 - at) % {align} if {length} else 0")
            self._add(self.unpack, f"{made} = bytes_at(data, at, {length} * {size})", f"at += len({made})")
            return made
        each = next(self._names)
        self._add(self.pack, f"for {each} in {value}:")
        self._add(self.unpack, f"{made} = []", f"for _ in range({length}):")
        self._indent += "    "
        item = self.message(kind, each)
        self.flush()
        self._add(self.unpack, f"{made}.append({item})")
        self._indent = self._indent[:-4]
        return f"tuple({made})"

    def _run(self, codes: Sequence[str], *given: str) -> list[str]:
        """Add numbers to the current run; return their names in the decoder."""
        taken = list(islice(self._names, len(codes)))
        self._codes += codes
        self._given += given
        self._taken += taken
        return taken

    def _add(self, lines: list[str], *texts: str) -> None:
        lines += [self._indent + text for text in texts]


def _layout(codes: Sequence[str], at: int) -> struct.Struct:
    """Return the struct of these numbers with CDR padding.

    ``at``: offset of the first number from the payload's start, bytes; only its value modulo 8 matters.
    """
    out = "<"
    for code in codes:
        size = struct.calcsize("<" + code)
        padding = 0 if code.endswith("s") else (len(CDR_HEADER) - at) % size
        out += f"{padding}x{code}"
        at += padding + size
    return struct.Struct(out)


def _bytes_at(data: bytes, at: int, size: int) -> bytes:
    raw = data[at : at + size]
    if len(raw) != size:
        raise ValueError(f"{size} bytes at byte {at} of {len(data)} are cut short")
    return raw


def _refuse(what: str, found: bytes, allowed: bytes) -> None:
    raise ValueError(f"{what} {found!r}, allowed is {allowed!r}")
