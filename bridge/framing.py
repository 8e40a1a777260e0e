"""Finds the MAVLink 2 frames in a datagram: pure bytes in, bytes out.

A stream parser believes the length byte of whatever looks like a start; one stray 0xFD then costs several
good frames, and a cut datagram spoils the next. So each datagram stands alone here, a frame counts only when
its checksum is right, and after anything else the search goes on at the very next byte.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as dialect

_MARKER_V1 = 0xFE
_MARKER_V2 = 0xFD
_HEADER_V1 = 6  # bytes: marker, length, sequence, system, component, id
_HEADER_V2 = 10  # bytes: as above with two flag bytes and an id of three bytes
_CHECKSUM = 2  # bytes
_SIGNATURE = 13  # bytes: link id, timestamp, signature
FLAG_SIGNED = 0x01  # the only incompatibility flag MAVLink 2 defines

# CRC_EXTRA of every message of the dialect: the checksum also covers the message's definition.
CRC_EXTRA: dict[int, bytes] = {id_: bytes([cls.crc_extra]) for id_, cls in dialect.mavlink_map.items()}
# CRC-16/MCRF4XX by fastcrc; pymavlink's slow class only where that has no build.
checksum = dialect.mcrf4xx or (lambda data: dialect.x25crc(data).crc)


@dataclass(slots=True)
class FrameCounters:
    """What was thrown away, for the log and for the person who wonders why nothing arrives."""

    garbage_bytes: int = 0  # bytes that belong to no accepted frame
    bad_crc: int = 0  # looked like a frame of a known message, but the checksum was wrong
    unknown_id: int = 0  # looked like a frame of a message the dialect does not have: cannot be checked
    version_1: int = 0  # valid MAVLink 1 frames, refused: they can never be signed
    undecodable: int = 0  # good checksum, yet the payload could not be decoded


def split_frames(datagram: bytes, counters: FrameCounters | None = None) -> Iterator[bytes]:
    """Yield every MAVLink 2 frame of a known message with a correct checksum, in order.

    Args:
        datagram: the bytes of one datagram, anything at all.
        counters: counts what was skipped, if given.

    Yields:
        Frames from marker to checksum, or to the end of the signature of a signed frame.
    """
    count = counters if counters is not None else FrameCounters()
    size = len(datagram)
    pos = 0
    while pos < size:
        end = _frame_end(datagram, pos, size, count)
        if end:
            yield datagram[pos:end]
            pos = end
            continue
        skip = _version_1_length(datagram, pos, size)
        if skip:
            count.version_1 += 1
            pos += skip
            continue
        count.garbage_bytes += 1
        pos += 1


def with_signed_flag(frame: bytes) -> bytes:
    """Set the flag of an unsigned frame and correct its checksum; 13 bytes of signature come behind it."""
    return _with_flags(frame, len(frame), FLAG_SIGNED)


def without_signature(frame: bytes) -> bytes:
    """Turn a signed frame into the same frame as it would have been sent without signing."""
    return _with_flags(frame, len(frame) - _SIGNATURE, 0)


def intact(frame: bytes) -> bool:
    """Whether a whole unsigned frame of a known message still has the checksum it was made with."""
    return _frame_end(frame, 0, len(frame), FrameCounters()) == len(frame)


def _with_flags(frame: bytes, end: int, flags: int) -> bytes:
    crc_at = end - _CHECKSUM
    changed = bytearray(frame[:end])
    changed[2] = flags
    extra = CRC_EXTRA[frame[7] | frame[8] << 8 | frame[9] << 16]
    crc = checksum(bytes(changed[1:crc_at]) + extra)
    changed[crc_at], changed[crc_at + 1] = crc & 0xFF, crc >> 8
    return bytes(changed)


def _frame_end(data: bytes, pos: int, size: int, count: FrameCounters) -> int:
    """End of the valid frame that starts at ``pos``, or 0."""
    if data[pos] != _MARKER_V2 or pos + _HEADER_V2 + _CHECKSUM > size:
        return 0
    flags = data[pos + 2]
    if flags & ~FLAG_SIGNED:
        return 0  # a flag we do not know means a frame we must not interpret (MAVLink 2 packet format)
    crc_at = pos + _HEADER_V2 + data[pos + 1]
    end = crc_at + _CHECKSUM + (_SIGNATURE if flags else 0)
    if end > size:
        return 0
    extra = CRC_EXTRA.get(data[pos + 7] | data[pos + 8] << 8 | data[pos + 9] << 16)
    if extra is None:
        count.unknown_id += 1
        return 0
    if checksum(data[pos + 1 : crc_at] + extra) != data[crc_at] | data[crc_at + 1] << 8:
        count.bad_crc += 1
        return 0
    return end


def _version_1_length(data: bytes, pos: int, size: int) -> int:
    """Length of the valid MAVLink 1 frame that starts at ``pos``, or 0."""
    if data[pos] != _MARKER_V1 or pos + _HEADER_V1 + _CHECKSUM > size:
        return 0
    crc_at = pos + _HEADER_V1 + data[pos + 1]
    extra = CRC_EXTRA.get(data[pos + 5])
    if extra is None or crc_at + _CHECKSUM > size:
        return 0
    if checksum(data[pos + 1 : crc_at] + extra) != data[crc_at] | data[crc_at + 1] << 8:
        return 0
    return crc_at + _CHECKSUM - pos
