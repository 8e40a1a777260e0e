"""Finds MAVLink 2 frames in a byte stream: what is cut is kept until the rest has come, in a bounded buffer.

Behind a checked frame the next start is believed for as long as its own length says. Elsewhere, after noise,
only a header that names a known message of a fitting length is waited for; so a stray 0xFD keeps nothing
back. A candidate that turns out wrong costs its first byte alone, and the search goes on at the second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from bridge.mavlink.codec.framing import FrameCounters, NoFrame, frame_end, skipped, unknown_end
from bridge.mavlink.codec.wide_messages import MESSAGES

_MARKER = 0xFD
_HEADER = 10  # bytes
REST_MAX = 1120  # bytes kept; four frames of the greatest length: unknown ones, and what shows where they end


class StreamFramer:
    """Takes a stream in pieces and gives its frames."""

    def __init__(self, counters: FrameCounters) -> None:
        self._counters = counters
        self._rest = b""
        self._in_sync = True  # a frame may begin right at the start of the rest

    @property
    def waiting_bytes(self) -> int:
        """Bytes kept for later."""
        return len(self._rest)

    def push(self, piece: bytes, unknown: Callable[[bytes], None] | None = None) -> Iterator[bytes]:
        """Take the next piece; yields frames as :func:`bridge.mavlink.codec.framing.split_frames` does."""
        data, self._rest = self._rest + piece, b""
        count, size, pos = self._counters, len(data), 0
        while pos < size:
            end = frame_end(data, pos, size, count)
            if end == NoFrame.UNKNOWN:
                end = unknown_end(data, pos, size, whole=False)
                if end > 0:
                    count.unknown_frames += 1
                    if unknown is not None:
                        unknown(data[pos:end])
                    pos, self._in_sync = end, True
                    continue
                count.unknown_id += end == NoFrame.INVALID
            if end > 0:
                yield data[pos:end]
                pos, self._in_sync = end, True
                continue
            if end == NoFrame.CUT_SHORT and size - pos <= REST_MAX and self._worth_waiting(data, pos, size):
                break
            self._in_sync = False
            pos += skipped(data, pos, size, count)
        self._rest = data[pos:]

    def _worth_waiting(self, data: bytes, pos: int, size: int) -> bool:
        if self._in_sync or size - pos < _HEADER:
            return True
        message = MESSAGES.get(data[pos + 7] | data[pos + 8] << 8 | data[pos + 9] << 16)
        fits = message is not None and data[pos + 1] <= message.unpacker.size
        return fits and 0 not in data[pos + 5 : pos + 7]
