"""The socket between the processes of a run and the flight recorder, and the client of a process.

The socket carries a stream of records, each a fixed header and a payload. The header holds the times and the
sequence number, so the recorder never parses the payload of a message. A process buffers its records during a
tick and sends them at its end. The recorder is a separate process, so a full disk or a slow compressor never
stops the loop. In real time no call blocks: a record that does not fit into the bounded buffer is dropped and
counted in the log. In lockstep the simulation waits instead, so no message is lost.
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
SOCKET_PATH_MAX = 107  # maximum length of a socket path, bytes (unix(7))
MAX_PAYLOAD = 16 * 2**20  # maximum payload, bytes; a longer payload shows a corrupted stream


class Kind(IntEnum):
    """Kind of a record that a client sends to the recorder, with the form of its payload."""

    DECLARE = 0  # JSON {"topic", "schema"}; the sender chooses the channel number
    MESSAGE = 1  # CDR payload with its four-byte header
    METADATA = 2  # JSON {"name", "values": {str: str}}
    ATTACHMENT = 3  # one line of JSON {"name", "media_type"}, then the data
    LOSSES = 4  # JSON {"client", "dropped"}: number of dropped records so far; also the client's first record
    GOODBYE = 5  # orderly end of the client


class Record(NamedTuple):
    kind: int
    channel: int
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes


class WireError(ValueError):
    """The stream of a client contains an invalid record; the remaining data of this client cannot be read."""


def encode(
    kind: Kind, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
) -> bytes:
    return HEADER.pack(len(payload), kind, channel, log_time_ns, publish_time_ns, sequence) + payload


def encode_json(kind: Kind, channel: int, log_time_ns: int, content: object) -> bytes:
    return encode(kind, channel, log_time_ns, log_time_ns, 0, json.dumps(content).encode())


class Splitter:
    """Splits the byte stream of one client into records."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Record]:
        """Add bytes and return the records that are complete now, in order."""
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


BUFFER_LIMIT = 4 * 2**20  # maximum buffer for a slow recorder, bytes: several seconds of one vehicle's flight
PATIENCE_S = 8.0  # wall time for which a lossless or closing sender waits for the recorder, s
_MESSAGE = int(Kind.MESSAGE)
_SOCKET_BUFFER = 2**20  # bytes requested from the kernel, which may grant fewer


class FeedError(ConnectionError):
    """The recorder cannot be reached at the start of a process."""


class Feed:
    """Connection of one process to the recorder."""

    def __init__(self, sock: socket.socket | None, client: str, *, lossless: bool, vehicles: int = 1) -> None:
        """Make a feed from a connected socket; None: without a recorder. Other code calls :meth:`connect`."""
        self._sock = sock
        self._client = client
        self._lossless = lossless
        self._buffer, self._limit = bytearray(), BUFFER_LIMIT * vehicles
        self._channels: dict[tuple[str, str], int] = {}
        self._log_time_ns = 0
        self._reported = 0
        # whether the recorder accepts records; later records are ignored after it has ended
        self.alive = sock is not None
        self.dropped = 0  # number of dropped records: the recorder was too slow, or has ended
        if sock is not None:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BUFFER)
            self._report_losses()

    @staticmethod
    def connect(path: str | Path | None, client: str, *, lossless: bool, vehicles: int = 1) -> Feed:
        """Return a feed to the recorder that listens at ``path``; if None, a feed without a recorder.

        A lossless feed waits for the recorder (lockstep); any other feed never blocks (real time). The
        buffer limit is proportional to the number of vehicles.
        """
        if path is None:
            return Feed(None, client, lossless=False)
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
        """Return the number of a channel; the first call declares the channel."""
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
        if self._sock is None:
            return
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
        """Add a complete file to the log."""
        head = json.dumps({"name": name, "media_type": media_type}).encode() + b"\n"
        if len(head) + len(data) > MAX_PAYLOAD:
            raise ValueError(f"attachment {name} has {len(data)} bytes; at most {MAX_PAYLOAD} are allowed")
        now = self._log_time_ns
        self._append_always(encode(Kind.ATTACHMENT, 0, now, now, 0, head + data))

    def flush(self) -> None:
        """Send the buffer, once per tick. Never raises; :attr:`alive` becomes False without a recorder."""
        if not self.alive:
            return
        if self.dropped != self._reported and len(self._buffer) < self._limit // 2:
            self._report_losses()
        self._send()
        if self._lossless and self._buffer:
            self._drain(PATIENCE_S)

    def close(self) -> None:
        """Send the buffered records and GOODBYE within a bounded time, and close the socket."""
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
        """Add a record that later records need; these few records may exceed the limit of the buffer."""
        if self.alive:
            self._buffer += record

    def _make_room_or_drop(self, record: bytes) -> None:
        if self._lossless and self.alive:
            self._drain(PATIENCE_S)
        if self.alive and len(self._buffer) + len(record) <= self._limit:
            self._buffer += record
        else:
            self.dropped += 1

    def _report_losses(self) -> None:
        content = {"client": self._client, "dropped": self.dropped}
        self._buffer += encode_json(Kind.LOSSES, 0, self._log_time_ns, content)
        self._reported = self.dropped

    def _send(self) -> None:
        """Send as much as the socket accepts, in one call that does not block."""
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
        """Send the whole buffer within a time limit; a recorder that needs longer counts as ended."""
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
