"""The socket between the processes of a run and the flight recorder, and a process' side of it.

A stream of records, each a fixed header and a payload. The header carries the times and the sequence
number, so the recorder never parses the payload of a message. A process writes cheaply during a tick and
sends once at its end. The recorder is another process, so a full disk or a slow compressor never stops the
loop. In real time nothing here ever blocks: what does not fit in the bounded buffer is dropped whole and
counted in the log. In lockstep the simulation waits instead, so that a log is never short of a message.
"""

from __future__ import annotations

import json
import select
import socket
import struct
import time
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

HEADER = struct.Struct("<IHHqqI")  # payload length, kind, channel, log time ns, publish time ns, sequence
SOCKET_PATH_MAX = 107  # bytes (unix(7))
MAX_PAYLOAD = 16 * 2**20  # bytes; a longer one is a broken stream, not a message


class Kind(IntEnum):
    """Kind of a record's payload."""

    DECLARE = 0  # JSON {"topic", "schema"}; the channel number is the sender's
    MESSAGE = 1  # CDR with its four-byte header
    METADATA = 2  # JSON {"name", "values": {str: str}}
    ATTACHMENT = 3  # one line of JSON {"name", "media_type"}, then the data
    LOSSES = 4  # JSON {"client", "dropped"}: records the sender had to drop so far; also its introduction
    GOODBYE = 5  # orderly end


class Record(NamedTuple):
    kind: int
    channel: int
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes


class WireError(ValueError):
    """A stream that is not made of records; the rest of that client's data cannot be read."""


def encode(
    kind: Kind, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
) -> bytes:
    return HEADER.pack(len(payload), kind, channel, log_time_ns, publish_time_ns, sequence) + payload


def encode_json(kind: Kind, channel: int, log_time_ns: int, content: object) -> bytes:
    return encode(kind, channel, log_time_ns, log_time_ns, 0, json.dumps(content).encode())


class Splitter:
    """Cuts the byte stream of one client into records."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Record]:
        """Add bytes and return the records that are whole now, in order."""
        buffer = self._buffer
        buffer += data
        records: list[Record] = []
        at, end, size = 0, len(buffer), HEADER.size
        with memoryview(buffer) as view:
            while end - at >= size:
                length, kind, channel, log_time_ns, publish_time_ns, sequence = HEADER.unpack_from(buffer, at)
                if length > MAX_PAYLOAD:
                    raise WireError(f"record of {length} bytes; at most {MAX_PAYLOAD} are allowed")
                after = at + size + length
                if after > end:
                    break
                payload = view[at + size : after].tobytes()
                records.append(Record(kind, channel, log_time_ns, publish_time_ns, sequence, payload))
                at = after
        del buffer[:at]
        return records


BUFFER_LIMIT = 4 * 2**20  # bytes kept for a slow recorder, several seconds of one vehicle's flight
PATIENCE_S = 8.0  # wall time a lossless sender, or a closing one, waits for the recorder
_MESSAGE = int(Kind.MESSAGE)
_SOCKET_BUFFER = 2**20  # bytes requested from the kernel, which may grant less


class FeedError(ConnectionError):
    """The recorder cannot be reached at the start of a process."""


class Feed:
    """Connection of one process to the recorder."""

    def __init__(self, sock: socket.socket | None, client: str, *, lossless: bool, vehicles: int = 1) -> None:
        """Take over a connected socket; None: no recorder. Use :meth:`connect`."""
        self._sock = sock
        self._client = client
        self._lossless = lossless
        self._buffer, self._limit = bytearray(), BUFFER_LIMIT * vehicles
        self._channels: dict[tuple[str, str], int] = {}
        self._log_time_ns = 0
        self._reported = 0
        # whether the recorder still accepts records; writing to a dead feed does nothing
        self.alive = sock is not None
        self.dropped = 0  # records dropped so far: the recorder was too slow, or gone
        if sock is not None:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BUFFER)
            self._report_losses()

    @staticmethod
    def connect(path: str | Path | None, client: str, *, lossless: bool, vehicles: int = 1) -> Feed:
        """Return a feed to the recorder listening at ``path``; None: a feed without a recorder.

        A lossless feed waits for the recorder (lockstep), another one never blocks (real time). The buffer
        grows with the number of vehicles.
        """
        if path is None:
            return NullFeed()
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            sock.connect(str(path))
        except OSError as error:
            sock.close()
            hint = "start `flightstack record` first"
            if len(str(path)) > SOCKET_PATH_MAX:
                hint = f"paths of sockets have at most {SOCKET_PATH_MAX} bytes"
            raise FeedError(f"no flight recorder at {path}: {error.strerror or error}; {hint}") from error
        return Feed(sock, client, lossless=lossless, vehicles=vehicles)

    def channel(self, topic: str, schema: str) -> int:
        """Return the number of a channel, declaring it the first time."""
        number = self._channels.get((topic, schema))
        if number is None:
            number = self._channels[topic, schema] = len(self._channels) + 1
            declared = {"topic": topic, "schema": schema}
            self._append_always(encode_json(Kind.DECLARE, number, self._log_time_ns, declared))
        return number

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        """Buffer one message until the next :meth:`flush`; times in Unix ns (simulated in lockstep)."""
        self._log_time_ns = log_time_ns
        sequence &= 0xFFFFFFFF
        record = (
            HEADER.pack(len(payload), _MESSAGE, channel, log_time_ns, publish_time_ns, sequence) + payload
        )
        if self.alive and len(self._buffer) + len(record) <= self._limit:
            self._buffer += record
        else:
            self._make_room_or_drop(record)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        content = {"name": name, "values": {str(k): str(v) for k, v in values.items()}}
        self._append_always(encode_json(Kind.METADATA, 0, self._log_time_ns, content))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Put a whole file into the log."""
        head = json.dumps({"name": name, "media_type": media_type}).encode() + b"\n"
        if len(head) + len(data) > MAX_PAYLOAD:
            raise ValueError(f"attachment {name} has {len(data)} bytes; at most {MAX_PAYLOAD} are allowed")
        now = self._log_time_ns
        self._append_always(encode(Kind.ATTACHMENT, 0, now, now, 0, head + data))

    def flush(self) -> None:
        """Send what is buffered: once a tick. Never raises; a dead recorder clears :attr:`alive`."""
        if not self.alive:
            return
        if self.dropped != self._reported and len(self._buffer) < self._limit // 2:
            self._report_losses()
        self._send()
        if self._lossless and self._buffer:
            self._drain(PATIENCE_S)

    def close(self) -> None:
        """Send the rest within a bounded time, then the goodbye, and close the socket."""
        if self._sock is None:
            return
        if self.alive:
            if self.dropped != self._reported:
                self._report_losses()
            self._buffer += encode(Kind.GOODBYE, 0, self._log_time_ns, self._log_time_ns, 0, b"")
            self._send()
            self._drain(PATIENCE_S)
        self.alive = False
        self._sock.close()
        self._sock = None

    def _append_always(self, record: bytes) -> None:
        """Add a record that the rest of the log needs; there are few of them, so no bound applies."""
        if self.alive:
            self._buffer += record

    def _make_room_or_drop(self, record: bytes) -> None:
        if self._lossless and self.alive:
            self._drain(PATIENCE_S)
        if self.alive and len(self._buffer) + len(record) <= self._limit:
            self._buffer += record
        elif self._sock is not None:
            self.dropped += 1

    def _report_losses(self) -> None:
        content = {"client": self._client, "dropped": self.dropped}
        self._buffer += encode_json(Kind.LOSSES, 0, self._log_time_ns, content)
        self._reported = self.dropped

    def _send(self) -> None:
        """One non-blocking send of as much as the socket takes."""
        if self._sock is None or not self._buffer:
            return
        try:
            sent = self._sock.send(self._buffer)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self._die()
            return
        del self._buffer[:sent]

    def _drain(self, patience_s: float) -> None:
        """Send everything, waiting for the recorder up to a bound; a recorder slower than that is dead."""
        deadline_s = time.monotonic() + patience_s
        while self._buffer and self.alive and self._sock is not None:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                self._die()
                return
            poll = select.poll()
            poll.register(self._sock, select.POLLOUT)
            poll.poll(left_s * 1e3)
            self._send()

    def _die(self) -> None:
        self.alive = False
        self._buffer.clear()


class NullFeed(Feed):
    """A feed without a recorder: nothing is written or counted."""

    def __init__(self) -> None:
        super().__init__(None, "", lossless=False)

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None: ...
