"""Finds MAVLink frames of versions 1 and 2 in a stream of bytes, whatever else is in it. Pure.

PX4 sends version 1 on this link as long as nobody sent version 2 to its ground station port. A frame counts
when its checksum is right. Something that only looks like the start of a long frame holds nothing up: the
search goes on behind it, and a whole frame found there ends the wait for the rest of it.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.decoding import Message, decode
from bridge.mavlink.codec.framing import CRC_EXTRA, checksum

_V1, _V2 = 0xFE, 0xFD
_HEADER = {_V1: 6, _V2: 10}  # bytes
_CHECKSUM, _SIGNATURE = 2, 13  # bytes
_SIGNED = 0x01
_NOT_YET, _NEVER = 0, -1
FRAME_MAX = _HEADER[_V2] + 255 + _CHECKSUM + _SIGNATURE


class FrameStream:
    """Feed it what came; holds fewer than ``FRAME_MAX`` bytes between calls.

    Attributes:
        garbage_bytes: bytes that belonged to no frame.
        bad: frames of a good checksum that could not be decoded.
    """

    def __init__(self) -> None:
        self.garbage_bytes = 0
        self.bad = 0
        self._rest = b""
        self._version_1 = dialect.MAVLink(None)

    def feed(self, data: bytes) -> list[Message]:
        """Messages that are complete now, in order."""
        data = self._rest + data
        found: list[Message] = []
        used = at = 0
        waiting: int | None = None  # where a frame may begin whose end has not come
        while at < len(data):
            end = _frame_end(data, at)
            if end > 0:
                self.garbage_bytes += at - used
                self._decode(data[at:end], found)
                used = at = end
                waiting = None
                continue
            if end == _NOT_YET and waiting is None:
                waiting = at
            at += 1
        keep = len(data) if waiting is None else waiting
        self.garbage_bytes += keep - used
        self._rest = data[keep:]
        return found

    def _decode(self, frame: bytes, found: list[Message]) -> None:
        try:
            found.append(decode(frame) if frame[0] == _V2 else self._version_1.decode(bytearray(frame)))
        except (dialect.MAVError, ValueError, KeyError, TypeError):
            self.bad += 1


def _frame_end(data: bytes, at: int) -> int:
    """End of the good frame that begins here, ``_NOT_YET`` if it may still become one, else ``_NEVER``."""
    header = _HEADER.get(data[at])
    if header is None:
        return _NEVER
    left = len(data) - at
    if left < header:
        return _NOT_YET
    version_2 = data[at] == _V2
    flags = data[at + 2] if version_2 else 0
    number = data[at + 5]
    if version_2:
        number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
    extra = CRC_EXTRA.get(number)
    if extra is None or flags & ~_SIGNED:
        return _NEVER
    crc_at = header + data[at + 1]
    size = crc_at + _CHECKSUM + (_SIGNATURE if flags else 0)
    if left < size:
        return _NOT_YET
    good = checksum(data[at + 1 : at + crc_at] + extra) == data[at + crc_at] | data[at + crc_at + 1] << 8
    return at + size if good else _NEVER
