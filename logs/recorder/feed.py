"""The socket between the processes of a run and the flight recorder, and the client of a process.

The socket carries a stream of records, each a fixed header and a payload. The header holds the times and the
sequence number, so the recorder never parses the payload of a message. A process buffers its records during a
tick and sends them at the end of the tick. The recorder is a separate process, so a full disk or a slow
compressor never stops the loop. In real time only ``close`` waits: a record that does not fit into the
bounded buffer is dropped and counted in the log. In lockstep the simulation waits, so no message is lost.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypeAlias

import msgspec

HEADER = struct.Struct("<IIqqI")  # payload length, channel, log time ns, publish time ns, sequence
CONTROL = 0  # channel of the control records; records of other channels are messages
SOCKET_PATH_MAX = 107  # maximum length of a socket path, bytes (unix(7))
MAX_PAYLOAD = 16 * 2**20  # maximum payload, bytes; a longer payload shows a corrupted stream
MAX_ATTACHMENT = MAX_PAYLOAD - 2**16  # maximum attachment, bytes; the rest is for name and media type


class Declare(msgspec.Struct, tag=True):
    """A channel; the sender chooses its number, from 1 on."""

    channel: int
    topic: str
    schema: str


class Metadata(msgspec.Struct, tag=True):
    name: str
    values: dict[str, str]


class Attachment(msgspec.Struct, tag=True):
    name: str
    media_type: str
    data: bytes


class Losses(msgspec.Struct, tag=True):
    """Number of records that a client has dropped so far; sent first, because this record has the name."""

    client: str
    dropped: int


class Goodbye(msgspec.Struct, tag=True):
    """Orderly end of the client."""


Control: TypeAlias = Declare | Metadata | Attachment | Losses | Goodbye


class Record(NamedTuple):
    channel: int
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    payload: bytes  # CDR with its four-byte header, or a control record as MessagePack


class WireError(ValueError):
    """The stream of a client contains an invalid record; the remaining data of this client cannot be read."""


def encode(channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes) -> bytes:
    return HEADER.pack(len(payload), channel, log_time_ns, publish_time_ns, sequence) + payload


def control(content: Control, log_time_ns: int = 0) -> bytes:
    return encode(CONTROL, log_time_ns, log_time_ns, 0, msgspec.msgpack.encode(content))


def split(buffer: bytearray) -> list[Record]:
    """Remove the complete records from the received bytes of a client, and return them in order."""
    records: list[Record] = []
    at, end, size = 0, len(buffer), HEADER.size
    with memoryview(buffer) as view:
        while end - at >= size:
            length, channel, log_time_ns, publish_time_ns, sequence = HEADER.unpack_from(buffer, at)
            if length > MAX_PAYLOAD:
                raise WireError(f"record of {length} bytes; at most {MAX_PAYLOAD} are allowed")
            after = at + size + length
            if after > end:
                break
            payload = view[at + size : after].tobytes()
            records.append(Record(channel, log_time_ns, publish_time_ns, sequence, payload))
            at = after
    del buffer[:at]
    return records


BUFFER_LIMIT = 4 * 2**20  # maximum buffer per vehicle for a slow recorder, bytes: several seconds of flight
PATIENCE_S = 8.0  # wall time for which a lossless or closing sender waits for the recorder, s
_SOCKET_BUFFER = 2**20  # bytes requested from the kernel, which may grant fewer


class FeedError(ConnectionError):
    """The recorder does not accept a connection at the start of a process."""


class Feed:
    """Connection of one process to the recorder."""

    def __init__(self, sock: socket.socket | None, client: str, *, lossless: bool, vehicles: int = 1) -> None:
        """Make a feed from a connected socket; None: without a recorder. Other code calls :meth:`connect`."""
        self._sock, self._client, self._lossless = sock, client, lossless
        self._buffer, self._limit = bytearray(), BUFFER_LIMIT * vehicles
        self._channels: dict[tuple[str, str], int] = {}
        self._log_time_ns = 0
        self._reported = 0
        # whether the recorder accepts records; after it has ended, records are dropped
        self.alive = sock is not None
        self.dropped = 0  # number of dropped records: the recorder was too slow, or has ended
        if sock is not None:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BUFFER)
            self._report_losses()

    @staticmethod
    def connect(path: str | Path | None, client: str, *, lossless: bool, vehicles: int = 1) -> Feed:
        """Return a feed to the recorder that listens at ``path``; if None, a feed without a recorder.

        A lossless feed waits for the recorder (lockstep); any other feed waits only in ``close`` (real time).
        The buffer limit is proportional to the number of vehicles.
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
            self._control(Declare(number, topic, schema))
        return number

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        """Buffer one message until the next :meth:`flush`; times in Unix ns (simulated in lockstep)."""
        if self._sock is None:
            return
        self._log_time_ns = log_time_ns
        record = encode(channel, log_time_ns, publish_time_ns, sequence & 0xFFFFFFFF, payload)
        if self._lossless and len(self._buffer) + len(record) > self._limit:
            self._drain()
        if self.alive and len(self._buffer) + len(record) <= self._limit:
            self._buffer += record
        else:
            self.dropped += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record; a path among the values may contain bytes that are not UTF-8."""
        texts = {k: str(v).encode(errors="backslashreplace").decode() for k, v in values.items()}
        self._control(Metadata(name, texts))

    def attachment(self, name: str, media_type: str, data: bytes) -> None:
        if len(data) > MAX_ATTACHMENT:
            raise ValueError(f"attachment {name} has {len(data)} bytes; at most {MAX_ATTACHMENT} are allowed")
        self._control(Attachment(name, media_type, data))

    def flush(self) -> None:
        """Send the buffer, once per tick. Never raises; :attr:`alive` is False after the recorder ended."""
        if self.dropped != self._reported and len(self._buffer) < self._limit // 2:
            self._report_losses()
        if self._lossless:
            self._drain()
            return
        if not self._buffer or self._sock is None:
            return
        try:  # this call does not block, and sends as much as the socket accepts
            sent = self._sock.send(self._buffer)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self._die()
            return
        del self._buffer[:sent]

    def close(self) -> None:
        """Send the buffered records and ``Goodbye`` within ``PATIENCE_S``, and close the socket."""
        if self._sock is None:
            return
        if self.dropped != self._reported:
            self._report_losses()
        self._control(Goodbye())
        self._drain()
        self.alive = False
        self._sock.close()
        self._sock = None

    def _control(self, content: Control) -> None:
        """Buffer a control record; such records are few, and may exceed the limit of the buffer."""
        if self.alive:
            self._buffer += control(content, self._log_time_ns)

    def _report_losses(self) -> None:
        self._control(Losses(self._client, self.dropped))
        self._reported = self.dropped

    def _drain(self) -> None:
        """Send the whole buffer; a recorder that needs longer than ``PATIENCE_S`` counts as ended."""
        if not self._buffer or self._sock is None:
            return
        self._sock.settimeout(PATIENCE_S)
        try:
            self._sock.sendall(self._buffer)
        except OSError:
            self._die()
        else:
            self._buffer.clear()
            self._sock.setblocking(False)

    def _die(self) -> None:
        self.alive = False
        self._buffer.clear()
