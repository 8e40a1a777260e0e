"""Finds the MAVLink 2 frames in a datagram or a byte stream; no I/O.

A parser that trusts the length byte after every start marker loses several good frames after a stray 0xFD,
and a cut datagram damages the next datagram. Therefore each datagram is parsed alone, and a frame counts only
with a correct checksum; after any other byte the search continues at the next byte. The incomplete end of a
stream waits in a bounded buffer.

The checksum also covers the message's definition, so a frame of an unknown message cannot be checked: its raw
bytes are passed on if the frames around it confirm its length; it is never decoded.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from enum import IntEnum

from bridge.mavlink.codec.messages import CRC_EXTRA, MESSAGES, checksum

_MARKER_V1 = 0xFE
_MARKER_V2 = 0xFD
_HEADER_V1 = 6  # number of bytes of marker, length, sequence, system, component, id
_HEADER_V2 = 10  # number of bytes of version 1's fields, two flag bytes, and a longer id
_CHECKSUM = 2  # length of the checksum, bytes
_SIGNATURE = 13  # number of bytes of link id, timestamp and signature
FLAG_SIGNED = 0x01  # the only incompatibility flag that MAVLink 2 defines

_UNKNOWN_RUN_MAX = 4  # maximum number of frames of unknown messages in a row
# buffered bytes of a stream: four frames of the largest length, for unknown frames and for those that
# confirm their end
REST_MAX = 1120


@dataclass(slots=True)
class FrameCounters:
    """Counters of dropped bytes and frames, for the log and for diagnosis."""

    garbage_bytes: int = 0  # number of bytes that belong to no accepted frame
    bad_crc: int = 0  # number of possible frames of a known message with a wrong checksum
    unknown_id: int = 0  # number of possible frames of an unknown message that following bytes do not confirm
    unknown_frames: int = 0  # number of frames of unknown messages: recorded, but not checked or decoded
    version_1: int = 0  # number of valid MAVLink 1 frames; they are rejected: MAVLink 1 has no signatures
    undecodable: int = 0  # number of frames with a correct checksum and an invalid payload


class NoFrame(IntEnum):
    """Reason why no checked frame starts at a byte; all values are below the end of any frame."""

    INVALID = 0
    CUT_SHORT = -1  # the bytes end within the frame
    UNKNOWN = -2  # the message id has no checksum seed (CRC_EXTRA)


def split_frames(
    datagram: bytes, counters: FrameCounters | None = None, unknown: Callable[[bytes], None] | None = None
) -> Iterator[bytes]:
    """Yield every MAVLink 2 frame of a known message with a correct checksum, in order.

    Frames extend from marker to checksum, or to the end of the signature. ``counters`` counts skipped bytes
    and candidates. ``unknown`` is called with each frame of an unknown message: its header is plausible, it
    contains no checked frame, and it is followed by the end of the data, a checked frame, or unknown frames.
    """
    yield from _scan(datagram, counters if counters is not None else FrameCounters(), unknown, None)


class StreamFramer:
    """Splits a stream that arrives in chunks into frames.

    After a checked frame, the parser waits for the complete next frame. After noise it waits only for a
    header of a known message with a fitting length, so a stray 0xFD does not delay frames. Only the first
    byte of a wrong candidate is skipped.
    """

    def __init__(self, counters: FrameCounters) -> None:
        self._counters = counters
        self._rest = b""
        self.in_sync = True  # whether a frame may start at the first buffered byte

    def push(self, piece: bytes, unknown: Callable[[bytes], None] | None = None) -> Iterator[bytes]:
        """Add a chunk; yield frames as ``split_frames`` does."""
        data, self._rest = self._rest + piece, b""
        self._rest = data[(yield from _scan(data, self._counters, unknown, self)) :]

    def worth_waiting(self, data: bytes, pos: int, size: int) -> bool:
        """Whether to wait for the remaining bytes of a possible frame at ``pos``."""
        left = size - pos
        if left > REST_MAX:
            return False
        if self.in_sync or left < _HEADER_V2:
            return True
        message = MESSAGES.get(_message_id(data, pos))
        fits = message is not None and data[pos + 1] <= message.unpacker.size
        return fits and 0 not in data[pos + 5 : pos + 7]


def _scan(
    data: bytes, count: FrameCounters, unknown: Callable[[bytes], None] | None, stream: StreamFramer | None
) -> Generator[bytes, None, int]:
    """Yield the frames; return the start of the bytes to buffer (stream only)."""
    size, pos = len(data), 0
    while pos < size:
        end = frame_end(data, pos, size, count)
        if end > 0:
            yield data[pos:end]
        elif end == NoFrame.UNKNOWN:
            end = _unknown_end(data, pos, size, whole=stream is None)
            if end > 0:
                count.unknown_frames += 1
                if unknown is not None:
                    unknown(data[pos:end])
            elif end == NoFrame.INVALID:
                count.unknown_id += 1
        if end > 0:
            pos = end
        elif stream is not None and end == NoFrame.CUT_SHORT and stream.worth_waiting(data, pos, size):
            return pos
        elif (old := version_1_end(data, pos, size)) > 0:
            count.version_1 += 1
            pos = old
        else:
            count.garbage_bytes += 1
            pos += 1
        if stream is not None:
            stream.in_sync = end > 0
    return pos


def with_signed_flag(frame: bytes) -> bytes:
    """Set the signed flag of an unsigned frame and correct its checksum; the signature is added later."""
    return _with_flags(frame, len(frame), FLAG_SIGNED)


def without_signature(frame: bytes) -> bytes:
    return _with_flags(frame, len(frame) - _SIGNATURE, 0)


def intact(frame: bytes) -> bool:
    """Whether an unsigned frame of a known message has a correct checksum."""
    return frame_end(frame, 0, len(frame), FrameCounters()) == len(frame)


def frame_end(data: bytes, pos: int, size: int, count: FrameCounters) -> int:
    """Return the end of the checked frame at ``pos``, or a :class:`NoFrame`; count a wrong checksum."""
    if data[pos] != _MARKER_V2:
        return NoFrame.INVALID
    end = _claimed_end(data, pos, size)
    if end <= 0:
        return end
    extra = CRC_EXTRA.get(_message_id(data, pos))
    if extra is None:
        return NoFrame.UNKNOWN
    crc_at = pos + _HEADER_V2 + data[pos + 1]
    if checksum(data[pos + 1 : crc_at] + extra) != data[crc_at] | data[crc_at + 1] << 8:
        count.bad_crc += 1
        return NoFrame.INVALID
    return end


def _unknown_end(data: bytes, pos: int, size: int, *, whole: bool = True) -> int:
    """Return the end of the frame of an unknown message at ``pos``, judged by the bytes after it.

    INVALID: the bytes do not confirm a frame; CUT_SHORT: more bytes are needed. ``whole``: no more bytes
    follow, as in a datagram.
    """
    first = at = _claimed_end(data, pos, size)
    for _ in range(_UNKNOWN_RUN_MAX):
        if at == size:
            break
        end = frame_end(data, at, size, FrameCounters())
        if end > 0:
            break
        if end == NoFrame.CUT_SHORT and not whole:
            return NoFrame.CUT_SHORT
        if end != NoFrame.UNKNOWN or not _has_sender(data, at):
            return NoFrame.INVALID
        at = _claimed_end(data, at, size)
    else:
        return NoFrame.INVALID
    if not _has_sender(data, pos) or _holds_frame(data, pos + 1, first, size):
        return NoFrame.INVALID
    return NoFrame.CUT_SHORT if at == size and not whole else first


def _message_id(data: bytes, pos: int) -> int:
    return data[pos + 7] | data[pos + 8] << 8 | data[pos + 9] << 16


def _claimed_end(data: bytes, pos: int, size: int) -> int:
    """Return the end of the frame at ``pos`` from its length and flags, or a :class:`NoFrame`."""
    if pos + _HEADER_V2 + _CHECKSUM > size:
        return NoFrame.CUT_SHORT
    flags = data[pos + 2]
    if flags & ~FLAG_SIGNED:
        return NoFrame.INVALID  # an unknown flag forbids decoding (MAVLink 2 packet format)
    end = pos + _HEADER_V2 + data[pos + 1] + _CHECKSUM + (_SIGNATURE if flags else 0)
    return end if end <= size else NoFrame.CUT_SHORT


def _has_sender(data: bytes, pos: int) -> bool:
    """Whether system and component of a header belong to a sender; 0 means broadcast."""
    return data[pos + 5] != 0 and data[pos + 6] != 0


def _holds_frame(data: bytes, start: int, stop: int, size: int) -> bool:
    """Whether a checked frame starts within these bytes: stray bytes must never hide a good frame."""
    pos = data.find(_MARKER_V2, start, stop)
    while pos >= 0:
        if frame_end(data, pos, size, FrameCounters()) > 0:
            return True
        pos = data.find(_MARKER_V2, pos + 1, stop)
    return False


def _with_flags(frame: bytes, end: int, flags: int) -> bytes:
    """Set the flags and correct the checksum; the message may be unknown.

    The checksum is linear: for two messages of the same length and CRC_EXTRA its difference depends only on
    the bytes that differ.
    """
    crc_at = end - _CHECKSUM
    changed = bytearray(frame[:end])
    changed[2] = flags
    any_extra = b"\x00"
    difference = checksum(frame[1:crc_at] + any_extra) ^ checksum(bytes(changed[1:crc_at]) + any_extra)
    crc = (frame[crc_at] | frame[crc_at + 1] << 8) ^ difference
    changed[crc_at], changed[crc_at + 1] = crc & 0xFF, crc >> 8
    return bytes(changed)


def version_1_end(data: bytes, pos: int, size: int) -> int:
    """Return the end of the checked MAVLink 1 frame at ``pos``, or a :class:`NoFrame`."""
    if data[pos] != _MARKER_V1:
        return NoFrame.INVALID
    if pos + _HEADER_V1 + _CHECKSUM > size:
        return NoFrame.CUT_SHORT
    extra = CRC_EXTRA.get(data[pos + 5])
    if extra is None:
        return NoFrame.UNKNOWN
    crc_at = pos + _HEADER_V1 + data[pos + 1]
    if crc_at + _CHECKSUM > size:
        return NoFrame.CUT_SHORT
    good = checksum(data[pos + 1 : crc_at] + extra) == data[crc_at] | data[crc_at + 1] << 8
    return crc_at + _CHECKSUM if good else NoFrame.INVALID
