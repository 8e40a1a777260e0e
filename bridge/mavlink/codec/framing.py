"""Finds the MAVLink frames in a datagram or a byte stream; no I/O.

A parser that trusts the length byte after every start marker loses several good frames after a stray 0xFD,
and a cut datagram damages the next datagram. Therefore each datagram is parsed alone, and a frame counts only
with a correct checksum; after any other byte the search continues at the next byte. The checksum also covers
the message's definition, so a frame of an unknown message is dropped.
"""

from __future__ import annotations

from collections import Counter

from bridge.mavlink.codec.messages import CRC_EXTRA, checksum, message_id

_MARKER_V1 = 0xFE
_HEADERS = {_MARKER_V1: 6, 0xFD: 10}  # number of bytes before the payload, by start marker
_HEADER_V2 = 10
_CHECKSUM = 2  # length of the checksum, bytes
_SIGNATURE = 13  # number of bytes of link id, timestamp and signature
FLAG_SIGNED = 0x01  # the only incompatibility flag that MAVLink 2 defines


class Framer:
    """Splits datagrams, or a stream that arrives in chunks, into MAVLink 2 frames.

    Frames extend from marker to checksum, or to the end of the signature. A stream waits for the rest of a
    frame of at most 280 bytes whose header has a known message id. Only the first byte of a wrong candidate
    is skipped. Dropped bytes and frames are counted by the names in docs/how_to/security.md.
    """

    def __init__(self, counters: Counter[str], *, stream: bool = False) -> None:
        self._count, self._stream = counters, stream
        self._rest = b""

    def push(self, piece: bytes) -> list[bytes]:
        """Add a datagram or chunk; return the frames, in order."""
        data, pos, count, found = self._rest + piece, 0, self._count, list[bytes]()
        size = len(data)
        while pos < size:
            end = _claimed_end(data, pos, size, count)
            if end > size and self._stream:
                break
            if not pos < end <= size or not _is_valid(data, pos, count):
                count["garbage_bytes"] += 1
                end = pos + 1
            elif data[pos] == _MARKER_V1:
                count["version_1"] += 1
            else:
                found.append(data[pos:end])
            pos = end
        self._rest = data[pos:]
        return found


def split_frames(datagram: bytes, counters: Counter[str] | None = None) -> list[bytes]:
    """Return every MAVLink 2 frame of a datagram, in order; ``counters`` counts skipped bytes."""
    return Framer(counters if counters is not None else Counter()).push(datagram)


def with_signed_flag(frame: bytes) -> bytes:
    """Set the signed flag of an unsigned frame; a wrong checksum stays wrong. The signature follows."""
    return _with_flags(frame, len(frame), FLAG_SIGNED)


def without_signature(frame: bytes) -> bytes:
    return _with_flags(frame, len(frame) - _SIGNATURE, 0)


def _claimed_end(data: bytes, pos: int, size: int, count: Counter[str]) -> int:
    """Return the end of the frame at ``pos`` by its header, perhaps beyond the data; 0: no frame starts."""
    header = _HEADERS.get(data[pos])
    if header is None:
        return 0
    if pos + header > size:
        return size + 1
    flags = 0 if data[pos] == _MARKER_V1 else data[pos + 2]
    if flags & ~FLAG_SIGNED:
        return 0  # an unknown flag forbids decoding (MAVLink 2 packet format)
    if _id_at(data, pos) not in CRC_EXTRA:
        count["unknown_id"] += 1
        return 0
    return pos + header + data[pos + 1] + _CHECKSUM + (_SIGNATURE if flags else 0)


def _is_valid(data: bytes, pos: int, count: Counter[str]) -> bool:
    """Whether the checksum of the complete frame at ``pos`` is correct; count a wrong one."""
    crc_at = pos + _HEADERS[data[pos]] + data[pos + 1]
    crc = data[crc_at] | data[crc_at + 1] << 8
    valid: bool = checksum(data[pos + 1 : crc_at] + CRC_EXTRA[_id_at(data, pos)]) == crc
    count["bad_crc"] += not valid and data[pos] != _MARKER_V1
    return valid


def _id_at(data: bytes, pos: int) -> int:
    return data[pos + 5] if data[pos] == _MARKER_V1 else message_id(data[pos : pos + _HEADER_V2])


def _with_flags(frame: bytes, end: int, flags: int) -> bytes:
    """Set the flags and change the checksum by the same difference, so a wrong one remains wrong.

    The checksum is linear: for two messages of the same length and CRC_EXTRA, here 0, its difference depends
    only on the bytes that differ.
    """
    crc_at = end - _CHECKSUM
    changed = frame[:2] + bytes((flags,)) + frame[3:crc_at]
    difference = checksum(frame[1:crc_at] + b"\x00") ^ checksum(changed[1:] + b"\x00")
    crc: int = int.from_bytes(frame[crc_at:end], "little") ^ difference
    return changed + crc.to_bytes(2, "little")
