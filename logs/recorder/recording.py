"""The MCAP file of one flight, and the records of the recorder's clients that are written into it.

The file has one channel per topic and type, and is readable after any kind of end. Every channel is CDR with
a ros2msg schema. The profile is "ros2", which rosbag2, Foxglove, Rerun and PlotJuggler open without further
information (MCAP format registry).
"""

from __future__ import annotations

import contextlib
import os
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import BinaryIO

import msgspec
from mcap.writer import CompressionType, Writer

from logs.recorder import feed
from logs.recorder.derive import Derive, Derivers
from logs.recorder.feed import Record
from logs.schema import LOSSES
from logs.schema.events import Severity, pack_log
from logs.schema.schemas import LOG, schema_text, type_hash

CHUNK_BYTES = 256 * 1024  # maximum size of a chunk, bytes; a killed recorder loses at most the open chunk
_LIBRARY = f"crazyflie-flightstack {version('crazyflie-flightstack')}; mcap {version('mcap')}"
_QOS = "[]"  # empty list, as rosbags writes: the sender's quality of service is unknown


class DiskError(OSError):
    """The disk does not accept data, or loses data; the file ends at its last complete record."""


class SafeStream:
    """Unbuffered output that ends at a complete record even if the disk fails.

    The MCAP writer writes complete records. A record that does not fit is removed again, so the file remains
    readable up to the last complete record.
    """

    def __init__(self, raw: BinaryIO) -> None:
        self._raw, self._position = raw, 0

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        """Write all bytes. Raises DiskError: the disk failed, and no byte of ``data`` remains in the file."""
        view, written = memoryview(data), 0
        try:
            while written < len(view):
                written += self._raw.write(view[written:])
        except OSError as error:
            with contextlib.suppress(OSError):
                self._raw.seek(self._position)
                self._raw.truncate(self._position)
            raise DiskError(error.errno, error.strerror or str(error)) from error
        self._position += written
        return written

    def flush(self) -> None:
        """Do nothing: each write is passed to the system immediately."""

    def sync(self) -> None:
        """Pass the written data to the disk, which may take seconds. Raises DiskError: the disk failed."""
        try:
            os.fdatasync(self._raw.fileno())
        except OSError as error:
            raise DiskError(error.errno, error.strerror or str(error)) from error

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._raw.close()


class McapFile(Writer):  # type: ignore[misc]
    """The open log file of one flight or fleet; not thread-safe. Raises DiskError like ``SafeStream``."""

    def __init__(self, path: Path, *, stream: SafeStream | None = None) -> None:
        """Create the file; ``stream`` replaces the disk in tests."""
        self.output = stream or SafeStream(path.open("xb", buffering=0))
        super().__init__(self.output, CHUNK_BYTES, CompressionType.LZ4, enable_data_crcs=True)
        self.start("ros2", _LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    def channel(self, topic: str, schema: str) -> int:
        """Return the channel of a topic; senders of the same topic and type share a channel."""
        number = self._channels.get((topic, schema))
        if number is None:
            if schema not in self._schemas:
                self._schemas[schema] = self.register_schema(schema, "ros2msg", schema_text(schema).encode())
            properties = {"offered_qos_profiles": _QOS, "topic_type_hash": type_hash(schema)}
            number = self.register_channel(topic, "cdr", self._schemas[schema], properties)
            self._channels[topic, schema] = number
        return number

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        self.add_message(channel, log_time_ns, payload, publish_time_ns, sequence)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        self.add_metadata(name, dict(values))

    def attachment(self, name: str, media_type: str, log_time_ns: int, data: bytes) -> None:
        self.add_attachment(log_time_ns, log_time_ns, name, media_type, data)

    def close(self) -> None:
        self.finish()
        self.output.sync()
        self.output.close()


# Maximum duration of a chunk in log time, ns; needed in lockstep, which runs faster than the wall clock.
FLUSH_LOG_TIME_NS = 250_000_000
RECORDER_NAME = "flight_recorder"  # source of the recorder's events on /rosout, which depend on wall time
RECORDER = "recorder"  # metadata record with the counts of the recorder
# exceptions that a record with invalid content raises; the recorder continues with the next record
_NONSENSE = (ValueError, msgspec.MsgspecError, struct.error)


class RecorderError(Exception):
    """The recorder cannot start; the text has the reason."""


@dataclass
class Statistics:
    clients: int = 0
    invalid: int = 0  # number of records that could not be interpreted
    unfinished_bytes: int = 0  # number of bytes of incomplete records, at the end of a client
    crashed: int = 0  # number of clients that ended without a goodbye
    dropped: dict[str, int] = field(default_factory=dict)  # number of dropped records by client, as reported
    syncs: int = 0  # number of fdatasync calls on the file
    sync_worst_s: float = 0.0  # wall time of the longest fdatasync call, s
    failure: str = ""  # reason why the disk stopped accepting data


class Client:
    def __init__(self, number: int) -> None:
        self.name = f"client {number}"
        self.received = bytearray()  # received bytes of an incomplete record
        self.channels: dict[int, int] = {}  # channel numbers in the file by channel numbers of the client
        self.derivers: dict[int, Derive] = {}
        self.goodbye = False


class Recorder:
    """Writes the records of any number of clients into one file. Raises DiskError like ``McapFile``."""

    def __init__(self, file: McapFile) -> None:
        self._file = file
        self._derivers = Derivers()
        self._log_time_ns = 0
        self._flushed_log_time_ns = 0
        self._events = 0
        self.statistics = Statistics()  # counts of the recording so far

    def client(self) -> Client:
        self.statistics.clients += 1
        return Client(self.statistics.clients)

    def take(self, client: Client, data: bytes) -> None:
        """Write the received data of a client. Raises WireError: the client's further data are unreadable."""
        client.received += data
        for record in feed.split(client.received):
            try:
                if record.log_time_ns < 0 or record.publish_time_ns < 0:
                    raise ValueError(f"times {record[1:3]}; they begin at 0 (1970)")
                if record.channel == feed.CONTROL:
                    self._control(client, record)
                else:
                    self._message(client, record)
            except _NONSENSE as error:
                self._invalid(client, f"record of channel {record.channel}: {error}")

    def gone(self, client: Client) -> None:
        unfinished_bytes = len(client.received)
        self.statistics.unfinished_bytes += unfinished_bytes
        if not client.goodbye:
            self.statistics.crashed += 1
            cut = f"; {unfinished_bytes} bytes of an unfinished record lost" if unfinished_bytes else ""
            self._event(Severity.ERROR, f"{client.name} ended without a goodbye{cut}")

    def flush(self) -> None:
        """Pass all data written so far to the kernel, where they survive a crash of this process."""
        self._file.flush()
        self._flushed_log_time_ns = self._log_time_ns

    def sync(self) -> None:
        """Pass all data written so far to the disk, where they survive a power cut."""
        self.flush()
        begun_s, counts = time.monotonic(), self.statistics
        self._file.output.sync()
        counts.syncs += 1
        counts.sync_worst_s = max(counts.sync_worst_s, time.monotonic() - begun_s)

    def finish(self) -> None:
        """Write the counts and the index, and close the file."""
        counts = self.statistics
        self._file.metadata(LOSSES, {name: str(n) for name, n in sorted(counts.dropped.items())})
        told = {name: str(n) for name, n in vars(counts).items() if name not in ("dropped", "failure")}
        self._file.metadata(RECORDER, told)
        self._file.close()

    def _event(self, level: Severity, text: str) -> None:
        now = self._log_time_ns
        self._events += 1
        packed = pack_log(now, level, RECORDER_NAME, text)
        self._file.write(self._file.channel("/rosout", LOG), now, now, self._events, packed)

    def _message(self, client: Client, record: Record) -> None:
        number, log_time_ns, publish_time_ns, sequence, payload = record
        if number not in client.channels:
            raise ValueError("it was never declared")
        if log_time_ns > self._log_time_ns:
            self._log_time_ns = log_time_ns
            if log_time_ns - self._flushed_log_time_ns >= FLUSH_LOG_TIME_NS:
                self.flush()
        file = self._file
        file.write(client.channels[number], log_time_ns, publish_time_ns, sequence, payload)
        if number in client.derivers:
            for topic, schema, data in client.derivers[number](log_time_ns, payload):
                file.write(file.channel(topic, schema), log_time_ns, publish_time_ns, sequence, data)

    def _control(self, client: Client, record: Record) -> None:
        match msgspec.msgpack.decode(record.payload, type=feed.Control):
            case feed.Declare(number, topic, schema):
                client.channels[number] = self._file.channel(topic, schema)
                deriver = self._derivers.declare(topic, schema)
                if deriver is not None:
                    client.derivers[number] = deriver
            case feed.Metadata(name, values):
                self._file.metadata(name, values)
                self._derivers.metadata(name, values)
            case feed.Attachment(name, media_type, data):
                self._file.attachment(name, media_type, record.log_time_ns, data)
                self._derivers.attachment(name, data)
            case feed.Losses(name, dropped):
                client.name, before = name, self.statistics.dropped.get(name, 0)
                self.statistics.dropped[name] = max(before, dropped)
                if dropped > before:
                    text = f"{name} dropped {dropped} records so far: the recorder did not keep up"
                    self._event(Severity.WARN, text)
            case feed.Goodbye():
                client.goodbye = True

    def _invalid(self, client: Client, text: str) -> None:
        self.statistics.invalid += 1
        if self.statistics.invalid <= 20:  # the first 20 texts show the cause; all records are counted
            self._event(Severity.ERROR, f"{client.name}: {text}")
