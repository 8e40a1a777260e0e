"""MAVLink in the log: raw frames as ``mavros_msgs/msg/Mavlink``, decoded messages as ROS types.

``LOCAL_POSITION_NED`` becomes ``mavlink_msgs/msg/LocalPositionNed``: a header and the message's fields in
wire order, in the units of MAVLink. Names become lower case, as ROS requires; text of fixed length becomes a
string. In wire order (sorted by size, MAVLink serialization guide) most payloads are valid CDR without a
change.

Raw frames are restored without losing a bit. Version 2: 0xFD, length, incompatibility flags, compatibility
flags, sequence, system, component, message id (3 bytes), payload, checksum (2), signature (13) if flag 1 is
set. Version 1: 0xFE, length, sequence, system, component, message id, payload, checksum. This module
packs them by hand, in half the time of a generated packer, because most records of a log are frames.

The ``frame_id`` of every record is a short name of the frame's peer, which a metadata record explains. Names
number the peers in order of appearance, so that two runs of one seed use the same names although their ports
differ.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from bridge.ros2.codec import CDR_HEADER

PACKAGE = "mavlink_msgs/msg/"
_ROS = {
    "char": ("uint8", "B", 1),
    "uint8_t": ("uint8", "B", 1),
    "int8_t": ("int8", "b", 1),
    "uint16_t": ("uint16", "H", 2),
    "int16_t": ("int16", "h", 2),
    "uint32_t": ("uint32", "I", 4),
    "int32_t": ("int32", "i", 4),
    "float": ("float32", "f", 4),
    "uint64_t": ("uint64", "Q", 8),
    "int64_t": ("int64", "q", 8),
    "double": ("float64", "d", 8),
}


class Field(NamedTuple):
    """One field of a message, in wire order."""

    name: str  # name of the field in ROS
    kind: str  # ROS primitive type; "string" for text
    code: str  # code of the ``struct`` module
    size: int  # bytes of one element
    array: int  # number of array elements; 0: the field is no array
    comment: str  # unit or enumeration


class Type(NamedTuple):
    """One MAVLink message as a ROS type."""

    message: str  # MAVLink name, such as LOCAL_POSITION_NED
    schema: str  # ROS type, such as mavlink_msgs/msg/LocalPositionNed
    fields: tuple[Field, ...]
    size: int  # bytes of the whole payload
    verbatim: bool  # whether the payload, padded with zeros, is the CDR body without a change


@cache
def of(number: int) -> Type | None:
    """Return the message type with this id; None if the dialect has no such message."""
    cls = _dialect().get(number)
    return None if cls is None else _type(cls)


def definition(schema: str) -> str:
    """Return the ``.msg`` text of a type."""
    made = _type(_dialect()[_numbers()[schema]])
    lines = [
        f"# MAVLink {made.message}, fields in the order of the wire.",
        "",
        "std_msgs/Header header  # stamp = of the raw frame, frame_id = name of its peer",
    ]
    for field in made.fields:
        array = f"[{field.array}]" if field.array and field.kind != "string" else ""
        comment = f"  # {field.comment}" if field.comment else ""
        lines.append(f"{field.kind}{array} {field.name}{comment}")
    return "\n".join(lines) + "\n"


@cache
def _dialect() -> dict[int, Any]:
    """Return the classes of all known messages by number; the import is slow, so it waits until needed."""
    from bridge.mavlink.codec.messages import MESSAGES

    return MESSAGES


@cache
def _numbers() -> dict[str, int]:
    return {_schema(cls.msgname): number for number, cls in _dialect().items()}


def _schema(message: str) -> str:
    return PACKAGE + "".join(word.capitalize() for word in message.split("_"))


def _type(cls: Any) -> Type:
    """Read one of pymavlink's message classes."""
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    # a scalar has length 1 and array length 0; both lists are in wire order
    counts = zip(cls.ordered_fieldnames, cls.lengths, cls.array_lengths, strict=True)
    fields, verbatim, at = [], True, 0
    for name, length, array in counts:
        kind, code, size = _ROS[kinds[name]]
        text = kinds[name] == "char" and array > 0
        comment = cls.fieldunits_by_name.get(name) or cls.fieldenums_by_name.get(name) or ""
        comment = comment.encode("ascii", "replace").decode()
        fields.append(Field(name.lower(), "string" if text else kind, code, size, array, comment))
        verbatim = verbatim and not text and at % size == 0
        at += size * max(1, length)
    layout: struct.Struct = cls.unpacker
    return Type(cls.msgname, _schema(cls.msgname), tuple(fields), layout.size, verbatim)


MAVLINK_PEERS = "mavlink_peers"  # metadata record with the address HOST:PORT of each peer name
NAMED_MAX = 99  # maximum number of named peers, since any sender can reach an open port
OTHERS = b"p99"  # name that all peers after the first ``NAMED_MAX`` share

_NS = 1_000_000_000  # nanoseconds per second
_V1, _V2 = 0xFE, 0xFD
_V1_OVERHEAD, _V2_OVERHEAD, _SIGNATURE = 8, 12, 13  # bytes of header and checksum; bytes of the signature
_SIGNED = 1  # flag MAVLINK_IFLAG_SIGNED
_FRAMING_OK = 1  # every recorded frame has passed its checksum

# Encapsulation, stamp, frame_id, framing_status .. compid, message id, checksum, number of words, and four
# bytes of padding before the first word. A frame_id is empty or has three characters: without them the fields
# up to compid start earlier, in its padding, and the later fields keep their places.
_HEAD = struct.Struct("<4siII4s8BIH2xI4x")
_HEAD_EMPTY = struct.Struct("<4siII4s8BIH2xI")  # no padding follows if there are no words
_HEAD_NOBODY = struct.Struct("<4siIIB8B3xIH2xI4x")
_HEAD_NOBODY_EMPTY = struct.Struct("<4siIIB8B3xIH2xI")
PEER_CHARACTERS = 3
_U32 = struct.Struct("<I")
_NAMED = bytes((PEER_CHARACTERS + 1,))  # first byte of the length of a frame_id that is not empty
_WORDS_AT = _HEAD.size
_UNSIGNED = _U32.pack(0)
_SIGNED_LENGTH = _U32.pack(_SIGNATURE)


class FrameError(ValueError):
    """Bytes that are not one complete MAVLink frame, or a record without one."""


def pack_mavlink(stamp_ns: int, frame: bytes, peer: bytes = b"") -> bytes:
    """Return one raw frame as CDR; the peer has three characters (:class:`PeerNames`) or none."""
    size = len(frame)
    if size >= _V2_OVERHEAD and frame[0] == _V2:
        length, end = frame[1], 10 + frame[1]
        signature = frame[end + 2 :]
        if len(signature) != (_SIGNATURE if frame[2] & _SIGNED else 0) or size < end + 2:
            raise _not_a_frame(frame)
        payload = frame[10:end]
        flags_to_component = (frame[2], frame[3], frame[4], frame[5], frame[6])
        message_id = frame[7] | frame[8] << 8 | frame[9] << 16
    elif size >= _V1_OVERHEAD and frame[0] == _V1 and size == _V1_OVERHEAD + frame[1]:
        length, end = frame[1], 6 + frame[1]
        signature, payload = b"", frame[6:end]
        flags_to_component = (0, 0, frame[2], frame[3], frame[4])
        message_id = frame[5]
    else:
        raise _not_a_frame(frame)
    if peer:
        if len(peer) != PEER_CHARACTERS:
            raise FrameError(f"peer {peer!r}; it must have {PEER_CHARACTERS} characters")
        layout = _HEAD if length else _HEAD_EMPTY
        name: tuple[int, bytes | int] = (PEER_CHARACTERS + 1, peer + b"\x00")
    else:
        layout, name = (_HEAD_NOBODY if length else _HEAD_NOBODY_EMPTY), (1, 0)
    head = layout.pack(
        CDR_HEADER, stamp_ns // _NS, stamp_ns % _NS, *name, _FRAMING_OK, frame[0], length,
        *flags_to_component, message_id, frame[end] | frame[end + 1] << 8, (length + 7) >> 3,
    )  # fmt: skip
    padding = bytes(-length & 7)
    if signature:
        return b"".join((head, payload, padding, _SIGNED_LENGTH, signature))
    return head + payload + padding + _UNSIGNED


def unpack_mavlink(data: bytes) -> tuple[int, bytes]:
    """Return (stamp in ns, raw frame) of a CDR payload of :func:`pack_mavlink`."""
    named = data[12:13] == _NAMED
    try:
        (header, seconds, nanoseconds, name_length, _, _, magic, length, incompat, compat, sequence, system,
         component, message_id, checksum, words) = (
            (_HEAD_EMPTY if named else _HEAD_NOBODY_EMPTY).unpack_from(data, 0)
        )  # fmt: skip
        payload_at = _WORDS_AT if words else _HEAD_EMPTY.size
        (signature_length,) = _U32.unpack_from(data, payload_at + 8 * words)
    except struct.error as error:
        raise FrameError(f"frame record of {len(data)} bytes is cut short: {error}") from error
    signature_at = payload_at + 8 * words + 4
    signature = data[signature_at : signature_at + signature_length]
    payload = data[payload_at : payload_at + length]
    if (
        header != CDR_HEADER
        or name_length != (PEER_CHARACTERS + 1 if named else 1)
        or words != (length + 7) >> 3
        or len(signature) != signature_length
    ):
        raise FrameError(f"frame record contradicts itself: {bytes(data[:48]).hex()}")
    tail = struct.pack("<H", checksum)
    if magic == _V2:
        start = bytes((_V2, length, incompat, compat, sequence, system, component))
        frame = start + message_id.to_bytes(3, "little") + payload + tail + signature
    elif magic == _V1:
        frame = bytes((_V1, length, sequence, system, component, message_id)) + payload + tail
    else:
        raise FrameError(f"frame record with magic {magic:#x}; allowed are {_V2:#x} and {_V1:#x}")
    return seconds * _NS + nanoseconds, frame


class Parts(NamedTuple):
    """Header and payload of a frame."""

    sequence: int
    system: int
    component: int
    number: int  # message id
    payload: bytes


def parts(frame: bytes) -> Parts:
    """Return header and payload of a frame of either version."""
    if frame[0] == _V2:
        number = int.from_bytes(frame[7:10], "little")
        return Parts(frame[4], frame[5], frame[6], number, frame[10 : 10 + frame[1]])
    return Parts(frame[2], frame[3], frame[4], frame[5], frame[6 : 6 + frame[1]])


def peer_of(data: bytes) -> str:
    """Return the peer in a CDR payload of :func:`pack_mavlink`; empty: unknown."""
    return bytes(data[16:19]).decode("ascii", "replace") if data[12:13] == _NAMED else ""


def _not_a_frame(frame: bytes) -> FrameError:
    return FrameError(
        f"not one whole MAVLink frame: {len(frame)} bytes beginning with {bytes(frame[:12]).hex()}"
    )


class PeerNames:
    """Names peers in order of appearance: ``p00``, ``p01``, ..."""

    def __init__(self, metadata: Callable[[str, dict[str, str]], None], record: str = MAVLINK_PEERS) -> None:
        """``metadata``: function that writes a metadata record; each new name is written to ``record``."""
        self._metadata, self._record = metadata, record
        self._names: dict[tuple[str, int], bytes] = {}

    def __call__(self, peer: tuple[str, int]) -> bytes:
        """Return the three-character name of a peer (host, port); a new name is recorded."""
        name = self._names.get(peer)
        if name is None:
            if len(self._names) >= NAMED_MAX:
                return OTHERS
            name = self._names[peer] = b"p%02d" % len(self._names)
            self._metadata(self._record, {name.decode(): f"{peer[0]}:{peer[1]}"})
        return name
