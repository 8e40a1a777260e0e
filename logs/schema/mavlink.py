"""MAVLink in the log: raw frames as ``mavros_msgs/msg/Mavlink``, and the values of decoded messages.

A record restores its frame without losing a bit: 0xFD, length, incompatibility flags, compatibility flags,
sequence, system, component, message id (3 bytes), payload, checksum (2), signature (13) if flag 1 is set.

The ``frame_id`` of every record is a short name of the frame's peer, which a metadata record explains. Names
number the peers in order of appearance, so that two runs of one seed use the same names although their ports
differ.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any, NamedTuple

from logs.schema.schemas import MAVLINK, codec, mavlink_class, packer

MAVLINK_PEERS = "mavlink_peers"  # metadata record with the address HOST:PORT of each peer name
NAMED_MAX = 99  # maximum number of peers with a name of their own, since any sender can reach an open port
OTHERS = "p99"  # name that all peers after the first ``NAMED_MAX`` share
_MARKER = 0xFD
_FRAMING_OK = 1  # every recorded frame has passed its checksum
_pack, _unpack = codec(MAVLINK, frame_id=None)


class Record(NamedTuple):
    """A raw MAVLink 2 frame of the log."""

    stamp_ns: int
    peer: str  # name of the peer; empty: unknown
    frame: bytes

    @property
    def sender(self) -> tuple[int, int]:
        """System and component id."""
        return self.frame[5], self.frame[6]

    @property
    def message_id(self) -> int:
        return int.from_bytes(self.frame[7:10], "little")


def pack_mavlink(stamp_ns: int, frame: bytes, peer: str = "") -> bytes:
    """Return one whole raw frame as CDR; ``peer`` is a name of :class:`PeerNames`, or empty."""
    end = 10 + frame[1]
    message_id, checksum = frame[7] | frame[8] << 8 | frame[9] << 16, frame[end] | frame[end + 1] << 8
    payload, signature = frame[10:end] + bytes(-frame[1] & 7), frame[end + 2 :]
    return _pack(((stamp_ns, peer), _FRAMING_OK, *frame[:7], message_id, checksum, payload, signature))


def unpack_mavlink(data: bytes) -> Record:
    """Return the frame in a CDR payload of :func:`pack_mavlink`."""
    (stamp_ns, peer), _, *head, message_id, checksum, payload, signature = _unpack(data)
    if head[0] != _MARKER or len(payload) != (head[1] + 7) & ~7:
        raise ValueError(f"frame record contradicts itself: {data[:48].hex()}")
    begin, end = bytes(head) + message_id.to_bytes(3, "little"), checksum.to_bytes(2, "little")
    return Record(stamp_ns, peer, begin + payload[: head[1]] + end + signature)


def decoder(message_id: int) -> tuple[str, str, Callable[[Record], bytes]] | None:
    """Return name, schema and the function that decodes a frame into CDR; None: not in the dialect.

    Text ends at its first zero byte; bytes that are not UTF-8 become U+FFFD.
    """
    known = mavlink_class(message_id)
    if known is None:
        return None
    schema, cls = known
    size, pack = cls.unpacker.size, packer(schema, None)
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    wire = [
        (kinds[name] == "char", n) for name, n in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True)
    ]

    def decode(record: Record) -> bytes:
        payload = record.frame[10 : 10 + record.frame[1]]
        flat = iter(cls.unpacker.unpack(payload[:size].ljust(size, b"\x00")))
        values: list[Any] = [(record.stamp_ns, record.peer or "p--")]
        for is_char, length in wire:
            if is_char:
                raw = next(flat)
                values.append(raw.partition(b"\x00")[0].decode("utf-8", "replace") if length else raw[0])
            else:
                values.append(tuple(islice(flat, length)) if length else next(flat))
        return pack(values)

    return cls.msgname, schema, decode


class PeerNames:
    """Names peers in order of appearance: ``p00``, ``p01``, ..."""

    def __init__(self, metadata: Callable[[str, dict[str, str]], None], record: str = MAVLINK_PEERS) -> None:
        """``metadata``: function that writes a metadata record; each new name is written to ``record``."""
        self._metadata, self._record = metadata, record
        self._names: dict[tuple[str, int], str] = {}

    def __call__(self, peer: tuple[str, int]) -> str:
        """Return the name of a peer (host, port); a new name is recorded."""
        name = self._names.get(peer)
        if name is None:
            if len(self._names) >= NAMED_MAX:
                return OTHERS
            name = self._names[peer] = f"p{len(self._names):02d}"
            self._metadata(self._record, {name: f"{peer[0]}:{peer[1]}"})
        return name
