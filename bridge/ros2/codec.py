"""Generates functions that encode and decode CDR from message definitions.

A ROS 2 message is sent as a four-byte header and the fields in order, each aligned to its size. Consecutive
numbers are one ``struct`` call; strings and sequences separate such runs. The functions are generated as
source text, as ``collections.namedtuple`` generates its classes: a codec that reads the definition for each
message takes ten times as long. Tests compare the bytes with those of ``rosbags``.

The value of a message is the tuple of the values of its fields, in order:

=====================================  ================================================================
field                                  value
=====================================  ================================================================
``std_msgs/Header``                    its stamp, integer nanoseconds, where the frame is given with the
                                       packer; else (stamp, frame)
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
from typing import Any, NamedTuple

CDR_HEADER = b"\x00\x01\x00\x00"  # plain CDR, little-endian, no options (OMG DDSI-RTPS 10.5)
MAP = "map"  # world frame of every message of this stack
HEADER_TYPE = "std_msgs/msg/Header"
TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
CODES = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_NS = 1_000_000_000  # nanoseconds per second
_ALIGNMENT_MAX = 8  # size of the largest number, bytes

# Standard types by their ROS 2 definitions, so that no process loads a complete type store at start.
_STANDARD = {
    "builtin_interfaces/msg/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/msg/String": "string data",
    "rcl_interfaces/msg/Log": "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\n"
    "string file\nstring function\nuint32 line",
    "geometry_msgs/msg/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/msg/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/msg/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/msg/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "std_msgs/Header header\n"
    "geometry_msgs/PoseWithCovariance pose",
    "geometry_msgs/msg/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/msg/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/msg/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/msg/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "nav_msgs/msg/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
}
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


def standard(schema: str) -> tuple[Field, ...] | None:
    """Return the fields of a standard ROS 2 type, or None if ``_STANDARD`` does not have it."""
    return fields_of_text(_STANDARD[schema]) if schema in _STANDARD else None


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
    None each message has its own frame. ``fields`` returns the fields of a type. Payloads of foreign programs
    may have bytes after the message, and strings without a NUL at the end.
    """
    compiler = _Compiler(frame_id, fields)
    names = compiler.message(schema, "row")
    compiler.flush()
    pack = ["def pack(row):", *compiler.pack, f"    return {'bytes(out)' if compiler.large else 'out'}"]
    if compiler.large:
        first = next(n for n, line in enumerate(pack) if line.startswith("    out = "))
        pack.insert(first + 1, "    out = bytearray(out)")
    unpack = [
        "def unpack(data):",
        "    try:",
        *("    " + line for line in compiler.unpack),
        f"        if at != len(data) and not {foreign}:",
        "            raise ValueError(f'{len(data)} bytes, of which the last {len(data) - at} mean nothing')",
        "    except (ValueError, error) as problem:",
        f"        text = f'not a {schema}{'' if foreign else ' of this stack'}: {{problem}}; "
        "it begins with {data[:20].hex()}'",
        "        raise ValueError(text) from problem",
        f"    return make(({names}))",
    ]
    scope = {**compiler.constants, "NS": _NS, "CDR": CDR_HEADER, "error": struct.error, "bytes_at": _bytes_at}
    scope |= {"text_at": _foreign_text_at if foreign else _text_at, "refuse": _refuse, "make": make}
    exec("\n".join(pack + unpack), scope)
    return scope["pack"], scope["unpack"]


class _Compiler:
    """Builds the source text of encoder and decoder, which use equal names for their local variables.

    A variable's name joins field names by two underscores; helpers have three. ROS field names have neither.
    """

    def __init__(
        self, frame_id: str | None, fields: Callable[[str], tuple[Field, ...] | None] = standard
    ) -> None:
        self._known = fields
        self.pack: list[str] = []
        self.unpack: list[str] = []
        self.constants: dict[str, Any] = {}
        self.large = False  # whether the message has sequences of numbers, which a bytearray appends faster
        self._frame = None if frame_id is None else frame_id.encode() + b"\x00"
        self._indent = "    "
        self._at: int | None = 0  # offset from the start of the payload, bytes; None: known only at run time
        # Current run of numbers: codes, encoded expressions, decoded names, and the statements that follow.
        self._codes, self._given, self._taken = ["4s"], ["CDR"], ["cdr"]
        self._after = ["if cdr != CDR: refuse('encoding', cdr, CDR)"]

    def message(self, schema: str, value: str) -> str:
        """Generate code for all fields of a message type; return the names of their variables as a tuple."""
        fields = self._fields(schema)
        names = [f"{value}__{field.name}" for field in fields]
        joined = "".join(f"{name}, " for name in names)
        self.pack.append(f"{self._indent}({joined}) = {value}")
        for field, name in zip(fields, names, strict=True):
            self._field(field, name)
        return joined

    def flush(self) -> None:
        """End the current run of numbers."""
        if self._codes:
            given, taken = ", ".join(self._given), "".join(f"{name}, " for name in self._taken)
            if self._at is not None:
                layout = _layout(self._codes, self._at)
                name, self._at = self._constant(layout), self._at + layout.size
                self._line(self.pack, f"out = {name}.pack({given})")
                self._line(self.unpack, f"({taken}) = {name}.unpack_from(data)")
                self._line(self.unpack, f"at = {self._at}")
            else:
                name = self._constant([_layout(self._codes, at) for at in range(_ALIGNMENT_MAX)])
                self._line(self.pack, f"out += {name}[len(out) % {_ALIGNMENT_MAX}].pack({given})")
                self._line(self.unpack, f"layout = {name}[at % {_ALIGNMENT_MAX}]")
                self._line(self.unpack, f"({taken}) = layout.unpack_from(data, at)")
                self._line(self.unpack, "at += layout.size")
        self.unpack += [self._indent + line for line in self._after]
        self._codes, self._given, self._taken, self._after = [], [], [], []

    def _field(self, field: Field, v: str) -> None:
        kind = field.kind
        numbers = self._numbers(kind)
        if field.length and kind not in CODES:
            raise TypeError(
                f"field {field.name}: an array of {kind}; arrays of fixed length hold numbers only"
            )
        if field.length == 0:
            self._sequence(kind, numbers, v)
        elif kind == HEADER_TYPE:
            self._header(v)
        elif kind in TIME_TYPES:
            self._time(v)
        elif kind == "string":
            self._string(v)
        elif kind in CODES and field.length is None:
            self._run(CODES[kind], v, [v])
        elif numbers:
            codes = numbers * (field.length or 1)
            parts = [f"{v}___{n}" for n in range(len(codes))]
            self._run(codes, f"*{v}", parts, f"{v} = ({', '.join(parts)},)")
        else:
            values = self.message(kind, v)
            self._after.append(f"{v} = ({values})")

    def _fields(self, schema: str) -> tuple[Field, ...]:
        fields = self._known(schema)
        if fields is None:
            raise TypeError(f"unknown message type {schema!r}")
        return fields

    def _numbers(self, kind: str) -> list[str]:
        """Return the struct codes of a number or of a message of equal numbers; empty for other types."""
        if kind in CODES:
            return [CODES[kind]]
        if kind == "string":
            return []
        fields = self._fields(kind)
        codes = [CODES.get(field.kind, "") if field.length is None else "" for field in fields]
        return codes if len(set(codes)) == 1 and codes[0] else []

    def _header(self, v: str) -> None:
        if self._frame is None:
            self._line(self.pack, f"({v}___stamp, {v}___frame) = {v}")
            self._time(f"{v}___stamp")
            self._string(f"{v}___frame")
            self._after.append(f"{v} = ({v}___stamp, {v}___frame)")
            return
        self._time(v)
        frame, size = self._constant(self._frame), len(self._frame)
        self._run("I", str(size), [f"{v}___size"])
        check = f"if {v}___size != {size} or {v}___frame != {frame}: refuse('frame', {v}___frame, {frame})"
        self._run([f"{size}s"], frame, [f"{v}___frame"], check)

    def _time(self, v: str) -> None:
        self._run("i", f"{v} // NS", [f"{v}___s"])
        self._run("I", f"{v} % NS", [f"{v}___ns"], f"{v} = {v}___s * NS + {v}___ns")

    def _string(self, v: str) -> None:
        self._line(self.pack, f"{v}___raw = {v}.encode() + b'\\0'")
        self._run("I", f"len({v}___raw)", [f"{v}___size"])
        self._grow(f"{v}___raw")
        self._line(self.unpack, f"{v} = text_at(data, at, {v}___size)")
        self._line(self.unpack, f"at += {v}___size")

    def _sequence(self, kind: str, numbers: list[str], v: str) -> None:
        if numbers:
            self.large, size = True, struct.calcsize("<" + numbers[0])
            self._run("I", f"len({v}) // {size * len(numbers)}", [f"{v}___count"])
            # no padding if the sequence is empty
            self._grow(f"bytes((4 - len(out)) % {size}) + {v} if {v} else b''")
            self._line(self.unpack, f"at += (4 - at) % {size} if {v}___count else 0")
            self._line(self.unpack, f"{v} = bytes_at(data, at, {v}___count * {size * len(numbers)})")
            self._line(self.unpack, f"at += len({v})")
            return
        self._run("I", f"len({v})", [f"{v}___count"])
        self._grow()
        self._line(self.pack, f"for {v}___each in {v}:")
        self._line(self.unpack, f"{v}___made = []")
        self._line(self.unpack, f"for _ in range({v}___count):")
        self._indent += "    "
        values = self.message(kind, f"{v}___each")
        self.flush()
        self._line(self.unpack, f"{v}___made.append(({values}))")
        self._indent = self._indent[:-4]
        self._line(self.unpack, f"{v} = tuple({v}___made)")

    def _run(self, codes: Sequence[str], given: str, taken: list[str], after: str | None = None) -> None:
        self._codes += codes
        self._given.append(given)
        self._taken += taken
        if after is not None:
            self._after.append(after)

    def _grow(self, value: str | None = None) -> None:
        """End the current run and append bytes; the next field's offset is known only at run time."""
        self.flush()
        self._at = None
        if value is not None:
            self._line(self.pack, f"out += {value}")

    def _constant(self, value: Any) -> str:
        name = f"C{len(self.constants)}"
        self.constants[name] = value
        return name

    def _line(self, lines: list[str], text: str) -> None:
        lines.append(self._indent + text)


def _layout(codes: Sequence[str], at: int) -> struct.Struct:
    """Return the layout of numbers that start ``at`` bytes (or ``at`` modulo 8) from the payload's start."""
    out = "<"
    for code in codes:
        size = struct.calcsize("<" + code)
        padding = 0 if code.endswith("s") else (len(CDR_HEADER) - at) % size
        out += f"{padding}x{code}"
        at += padding + size
    return struct.Struct(out)


def _text_at(data: bytes, at: int, size: int) -> str:
    raw = _bytes_at(data, at, size)
    if raw[-1:] != b"\x00":
        raise ValueError(f"the text of {size} bytes at byte {at} has no end")
    return raw[:-1].decode()


def _foreign_text_at(data: bytes, at: int, size: int) -> str:
    return _bytes_at(data, at, size).removesuffix(b"\x00").decode()


def _bytes_at(data: bytes, at: int, size: int) -> bytes:
    raw = data[at : at + size]
    if len(raw) != size:
        raise ValueError(f"{size} bytes at byte {at} of {len(data)} are cut short")
    return raw


def _refuse(what: str, found: bytes, allowed: bytes) -> None:
    raise ValueError(f"{what} {found!r}, allowed is {allowed!r}")
