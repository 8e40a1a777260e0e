"""Finds the MAVLink frames in a datagram or a byte stream; no I/O.

A parser that trusts the length byte after every start marker loses several good frames after a stray 0xFD,
and a cut datagram damages the next datagram. Therefore each datagram is parsed alone, and a frame counts only
with a correct checksum; after any other byte the search continues at the next byte. The incomplete end of a
stream waits in a bounded buffer.

The checksum also covers the message's definition, so a frame of an unknown message cannot be checked. Such a
frame counts if its header is plausible, no checked frame starts within it, and the frame is followed by the
end of the data or the next frame.
"""

from __future__ import annotations

from collections import Counter
from enum import IntEnum

from bridge.mavlink.codec.messages import CRC_EXTRA, MESSAGES, checksum, message_id

_MARKER_V1 = 0xFE
_MARKER_V2 = 0xFD
_HEADER_V1 = 6  # number of bytes of marker, length, sequence, system, component, id
_HEADER_V2 = 10  # number of bytes of version 1's fields, two flag bytes, and an id of three bytes
_CHECKSUM = 2  # length of the checksum, bytes
_SIGNATURE = 13  # number of bytes of link id, timestamp and signature
FLAG_SIGNED = 0x01  # the only incompatibility flag that MAVLink 2 defines
REST_MAX = 560  # maximum number of buffered bytes of a stream: two frames of the maximum length


class NoFrame(IntEnum):
    """Reason why no checked frame starts at a byte; all values are below the end of any frame."""

    INVALID = 0
    CUT_SHORT = -1  # the data end within the frame
    UNKNOWN = -2  # the message id has no checksum seed (CRC_EXTRA)


class Framer:
    """Splits datagrams, or a stream that arrives in chunks, into MAVLink 2 frames.

    Frames extend from marker to checksum, or to the end of the signature. After a frame, a stream waits for
    the complete next frame. After noise it waits only if the header is that of a known message and the length
    fits, so a stray 0xFD delays no frames. Only the first byte of a wrong candidate is skipped. Dropped bytes
    and frames are counted under the names listed in docs/how_to/security.md.
    """

    def __init__(self, counters: Counter[str], *, stream: bool = False) -> None:
        self._count, self._stream = counters, stream
        self._rest = b""
        self._in_sync = True  # whether a frame may start at the first buffered byte

    def push(self, piece: bytes) -> list[bytes]:
        """Add a datagram or chunk; return the frames, in order."""
        data, pos, count, found = self._rest + piece, 0, self._count, list[bytes]()
        size = len(data)
        while pos < size:
            end = frame_end(data, pos, size, count)
            if end == NoFrame.UNKNOWN:
                end = self._unknown_end(data, pos, size)
                count["unknown_frames"] += end > 0
                count["unknown_id"] += end == NoFrame.INVALID
            if end == NoFrame.CUT_SHORT and self._worth_waiting(data, pos, size):
                break
            self._in_sync = end > 0
            if end <= 0:
                count["garbage_bytes"] += 1
            elif data[pos] == _MARKER_V1:
                count["version_1"] += 1
            else:
                found.append(data[pos:end])
            pos = max(end, pos + 1)
        self._rest = data[pos:]
        return found

    def _worth_waiting(self, data: bytes, pos: int, size: int) -> bool:
        """Whether to wait for the remaining bytes of a possible frame at ``pos``."""
        left = size - pos
        if not self._stream or left > REST_MAX:
            return False
        if self._in_sync or left < _HEADER_V2:
            return True
        message = MESSAGES.get(message_id(data[pos : pos + _HEADER_V2]))
        fits = message is not None and data[pos + 1] <= message.unpacker.size
        return data[pos] == _MARKER_V2 and fits and _has_sender(data, pos)

    def _unknown_end(self, data: bytes, pos: int, size: int) -> int:
        """Return the end of the frame of an unknown message at ``pos``, judged by the bytes around it."""
        end = _claimed_end(data, pos, size)
        if self._stream and end == size:
            return NoFrame.CUT_SHORT
        within = (at for at in range(pos + 1, end) if data[at] == _MARKER_V2)
        hides = any(frame_end(data, at, size, Counter()) > 0 for at in within)
        followed = end == size or data[end] == _MARKER_V2
        return end if followed and _has_sender(data, pos) and not hides else NoFrame.INVALID


def split_frames(datagram: bytes, counters: Counter[str] | None = None) -> list[bytes]:
    """Return every MAVLink 2 frame of a datagram, in order; ``counters`` counts skipped bytes."""
    return Framer(counters if counters is not None else Counter()).push(datagram)


def with_signed_flag(frame: bytes) -> bytes:
    """Set the signed flag of an unsigned frame that the caller then signs; a wrong checksum remains wrong."""
    return _with_flags(frame, len(frame), FLAG_SIGNED)


def without_signature(frame: bytes) -> bytes:
    return _with_flags(frame, len(frame) - _SIGNATURE, 0)


def frame_end(data: bytes, pos: int, size: int, count: Counter[str]) -> int:
    """Return the end of the checked frame at ``pos``, or a :class:`NoFrame`; count a wrong checksum."""
    end = _claimed_end(data, pos, size)
    if end <= 0:
        return end
    old = data[pos] == _MARKER_V1
    extra = CRC_EXTRA.get(data[pos + 5] if old else message_id(data[pos : pos + _HEADER_V2]))
    if extra is None:
        return NoFrame.INVALID if old else NoFrame.UNKNOWN
    crc_at = pos + (_HEADER_V1 if old else _HEADER_V2) + data[pos + 1]
    if checksum(data[pos + 1 : crc_at] + extra) == data[crc_at] | data[crc_at + 1] << 8:
        return end
    count["bad_crc"] += not old
    return NoFrame.INVALID


def _claimed_end(data: bytes, pos: int, size: int) -> int:
    """Return the end of the frame at ``pos`` from its length and flags, or a :class:`NoFrame`."""
    if data[pos] not in (_MARKER_V1, _MARKER_V2):
        return NoFrame.INVALID
    header = _HEADER_V1 if data[pos] == _MARKER_V1 else _HEADER_V2
    if pos + header + _CHECKSUM > size:
        return NoFrame.CUT_SHORT
    flags = data[pos + 2] if data[pos] == _MARKER_V2 else 0
    if flags & ~FLAG_SIGNED:
        return NoFrame.INVALID  # an unknown flag forbids decoding (MAVLink 2 packet format)
    end = pos + header + data[pos + 1] + _CHECKSUM + (_SIGNATURE if flags else 0)
    return end if end <= size else NoFrame.CUT_SHORT


def _has_sender(data: bytes, pos: int) -> bool:
    """Whether the system and component id of a header can be a sender's; 0 means broadcast."""
    return data[pos + 5] != 0 and data[pos + 6] != 0


def _with_flags(frame: bytes, end: int, flags: int) -> bytes:
    """Set the flags and correct the checksum; the message may be unknown.

    The checksum is linear: if two messages have the same length and CRC_EXTRA, the difference of their
    checksums depends only on the bytes that differ.
    """
    crc_at = end - _CHECKSUM
    changed = bytearray(frame[:end])
    changed[2] = flags
    any_extra = b"\x00"
    difference = checksum(frame[1:crc_at] + any_extra) ^ checksum(bytes(changed[1:crc_at]) + any_extra)
    crc = (frame[crc_at] | frame[crc_at + 1] << 8) ^ difference
    changed[crc_at], changed[crc_at + 1] = crc & 0xFF, crc >> 8
    return bytes(changed)
