"""The MCAP file of one flight, and the records of the recorder's clients that are written into it.

The file has the ROS 2 profile and one channel per topic, and is readable after any kind of end. Every channel
is CDR with a ros2msg schema. The profile is "ros2", which rosbag2, Foxglove, Rerun and PlotJuggler open
without further information (MCAP format registry).
"""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, McapRecord, Metadata
from mcap.writer import CompressionType, Writer

from logs.recorder.derive import Derive, Derivers
from logs.recorder.feed import Kind, Record
from logs.schema import LOSSES
from logs.schema.events import Severity, pack_log
from logs.schema.schemas import LOG, UnknownSchemaError, schema_text, type_hash

CHUNK_BYTES = 256 * 1024  # maximum size of a chunk, bytes; a killed recorder loses at most the open chunk
_QOS = "[]"  # empty list, as rosbags writes: the sender's quality of service is unknown


class SafeStream:
    """Unbuffered output that ends at a complete record even if the disk fails.

    The MCAP writer writes complete records. A record that does not fit is removed again, so the file remains
    readable up to the last complete one. ``tell`` still counts after a failure, since the writer needs it.
    """

    def __init__(self, raw: BinaryIO) -> None:
        self._raw = raw
        self._position = 0
        self._stopped = False
        self.failure = ""  # reason why writing stopped; empty as long as writing works

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        """Write all bytes or none; after a failure of the disk, write none."""
        self._stopped = self._stopped or not self._try(data)
        self._position += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: each write is passed to the system immediately."""

    def descriptor(self) -> int:
        return self._raw.fileno()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._raw.close()

    def _try(self, data: bytes) -> bool:
        view, written = memoryview(data), 0
        try:
            while written < len(view):
                written += self._raw.write(view[written:])
        except OSError as error:
            self.failure = self.failure or (error.strerror or str(error))
            with contextlib.suppress(OSError):
                self._raw.seek(self._position)
                self._raw.truncate(self._position)
            return False
        return True


class McapFile(Writer):  # type: ignore[misc]
    """The open log file of one flight or fleet; not thread-safe."""

    def __init__(self, path: Path, *, stream: SafeStream | None = None) -> None:
        """Create the file; ``stream`` replaces the disk in tests."""
        self.path = path
        self._output = stream or SafeStream(path.open("xb", buffering=0))
        super().__init__(self._output, CHUNK_BYTES, CompressionType.LZ4, enable_data_crcs=True)
        self.messages = 0  # number of messages written so far
        self.start("ros2", _library())
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    @property
    def failure(self) -> str:
        """Reason why the disk stopped accepting data; empty as long as the disk works."""
        return self._output.failure

    def fail(self, why: str) -> None:
        """Stop writing, because the disk has lost earlier data."""
        self._output.failure = self._output.failure or why

    def descriptor(self) -> int:
        """Return the descriptor of the open file, for :class:`logs.recorder.recorder.Syncer`."""
        return self._output.descriptor()

    def channel(self, topic: str, schema: str) -> int:
        """Return the channel of a topic; senders of the same topic and type share it."""
        number = self._channels.get((topic, schema))
        if number is None:
            if schema not in self._schemas:
                self._schemas[schema] = self.register_schema(schema, "ros2msg", schema_text(schema).encode())
            properties = {"offered_qos_profiles": _QOS, "topic_type_hash": type_hash(schema)}
            _encodable(Channel(0, topic, "cdr", properties, 0))
            number = self.register_channel(topic, "cdr", self._schemas[schema], properties)
            self._channels[topic, schema] = number
        return number

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        """Add one message; messages after a failure of the disk are ignored."""
        if not self._output.failure:
            self.add_message(channel, log_time_ns, payload, publish_time_ns, sequence)
            self.messages += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        _encodable(Metadata(name, dict(values)))
        self.add_metadata(name, dict(values))

    def attachment(self, name: str, media_type: str, log_time_ns: int, data: bytes) -> None:
        """Add a file to the log; it is ignored after a failure of the disk."""
        if not self._output.failure:
            _encodable(Attachment(log_time_ns, log_time_ns, name, media_type, data))
            self.add_attachment(log_time_ns, log_time_ns, name, media_type, data)

    def flush(self) -> None:
        """Close the open chunk, so that a crash cannot lose data written so far."""
        if not self._output.failure:
            super().flush()

    def close(self) -> None:
        self.finish()
        self._output.close()


def _encodable(record: McapRecord) -> None:
    """Check that a text can be encoded, before the writer has stored a part of its record."""
    record.write(RecordBuilder())


def _library() -> str:
    try:
        return f"crazyflie-flightstack {version('crazyflie-flightstack')}; mcap {version('mcap')}"
    except PackageNotFoundError:
        return "crazyflie-flightstack"


# Maximum log time of a chunk, ns; important in lockstep, which runs faster than the wall clock.
FLUSH_LOG_TIME_NS = 250_000_000
RECORDER_NAME = "flight_recorder"  # source of the recorder's events on /rosout; these depend on wall time
RECORDER = "recorder"  # metadata: counts and failures of the recorder
_TOLD = ("clients", "invalid", "refused", "unfinished_bytes", "crashed", "syncs", "sync_worst_s",
         "failure")  # fmt: skip
# Errors of records with invalid content; the recorder must survive them to keep the other records.
_NONSENSE = (ValueError, KeyError, TypeError, AttributeError, RecursionError, struct.error)


class RecorderError(Exception):
    """The recorder cannot start; the text has the reason."""


@dataclass
class Statistics:
    messages: int = 0  # number of messages in the file, including derived ones
    derived: int = 0
    clients: int = 0
    invalid: int = 0  # number of records that could not be interpreted
    refused: int = 0  # number of messages that arrived after the disk was full
    unfinished_bytes: int = 0  # number of bytes of records that are incomplete because their sender crashed
    crashed: int = 0  # number of clients that ended without a goodbye
    dropped: dict[str, int] = field(default_factory=dict)  # number of dropped records by client, as reported
    syncs: int = 0  # number of fdatasync calls on the file
    sync_worst_s: float = 0.0  # wall time of the longest fdatasync call, s
    failure: str = ""  # reason why the disk stopped accepting data


@dataclass
class _Client:
    name: str
    channels: dict[int, int] = field(default_factory=dict)  # channel number in the file by that of a client
    derivers: dict[int, Derive] = field(default_factory=dict)
    goodbye: bool = False


class Recorder:
    """Writes the records of any number of clients into one file."""

    def __init__(self, file: McapFile) -> None:
        self._file = file
        self._clients: dict[int, _Client] = {}
        self._derivers = Derivers()
        self._log_time_ns = 0
        self._flushed_log_time_ns = 0
        self._events = 0
        self.statistics = Statistics()  # counts of the recording so far
        self._handlers: Mapping[int, Callable[[_Client, Record], None]] = {
            Kind.DECLARE: self._declare,
            Kind.METADATA: self._metadata,
            Kind.ATTACHMENT: self._attachment,
            Kind.LOSSES: self._losses,
            Kind.GOODBYE: self._goodbye,
        }

    def handle(self, client: int, record: Record) -> None:
        """Write one record of a client into the file."""
        state = self._clients.get(client)
        if state is None:
            state = self._clients[client] = _Client(f"client {client}")
            self.statistics.clients += 1
        if record.kind == Kind.MESSAGE:
            self._message(state, record)
            return
        handler = self._handlers.get(record.kind)
        try:
            if handler is None:
                raise ValueError(f"kind {record.kind}")
            handler(state, record)
        except _NONSENSE as error:
            self._invalid(state, f"record of kind {record.kind}: {error}")

    def gone(self, client: int, unfinished_bytes: int) -> None:
        """Record the end of a connection; ``unfinished_bytes``: received part of its incomplete record."""
        state = self._clients.pop(client, None)
        self.statistics.unfinished_bytes += unfinished_bytes
        if state is not None and not state.goodbye and not self._file.failure:
            self.statistics.crashed += 1
            cut = f"; {unfinished_bytes} bytes of an unfinished record lost" if unfinished_bytes else ""
            self.event(Severity.ERROR, f"{state.name} ended without a goodbye{cut}")

    def event(self, level: Severity, text: str) -> None:
        now = self._log_time_ns
        self._events += 1
        packed = pack_log(now, level, RECORDER_NAME, text)
        self._file.write(self._file.channel("/rosout", LOG), now, now, self._events, packed)

    @property
    def failure(self) -> str:
        return self._file.failure

    def fail(self, why: str) -> None:
        """Stop recording, because the disk has lost earlier data."""
        self._file.fail(why)

    def flush(self) -> None:
        """Pass all data written so far to the kernel, where they survive a crash of this process."""
        self._file.flush()
        self._flushed_log_time_ns = self._log_time_ns

    def finish(self) -> Statistics:
        """Write the counts and the index, close the file, and return the counts."""
        counts = self.statistics
        counts.failure = self._file.failure
        self._file.metadata(LOSSES, {name: str(n) for name, n in sorted(counts.dropped.items())})
        self._file.metadata(RECORDER, {name: str(getattr(counts, name)) for name in _TOLD})
        self._file.close()
        counts.messages = self._file.messages
        counts.failure = self._file.failure
        return counts

    def _message(self, client: _Client, record: Record) -> None:
        _, number, log_time_ns, publish_time_ns, sequence, payload = record
        channel = client.channels.get(number)
        if channel is None:
            self._invalid(client, f"message on channel {number}, which was never declared")
            return
        if log_time_ns < 0 or publish_time_ns < 0:
            self._invalid(client, f"times {log_time_ns} and {publish_time_ns}; they begin at 0 (1970)")
            return
        if self._file.failure:
            self.statistics.refused += 1
            return
        if log_time_ns > self._log_time_ns:
            self._log_time_ns = log_time_ns
            if log_time_ns - self._flushed_log_time_ns >= FLUSH_LOG_TIME_NS:
                self.flush()
        file = self._file
        file.write(channel, log_time_ns, publish_time_ns, sequence, payload)
        deriver = client.derivers.get(number)
        if deriver is None:
            return
        try:
            derived = deriver(log_time_ns, payload)
        except _NONSENSE as error:
            self._invalid(client, str(error))
            return
        for topic, schema, data in derived:
            file.write(file.channel(topic, schema), log_time_ns, publish_time_ns, sequence, data)
        self.statistics.derived += len(derived)

    def _declare(self, client: _Client, record: Record) -> None:
        content = json.loads(record.payload)
        topic, schema = str(content["topic"]), str(content["schema"])
        try:
            client.channels[record.channel] = self._file.channel(topic, schema)
        except UnknownSchemaError as error:
            self._invalid(client, f"channel {topic}: {error}")
            return
        deriver = self._derivers.declare(topic, schema)
        if deriver is not None:
            client.derivers[record.channel] = deriver

    def _metadata(self, client: _Client, record: Record) -> None:  # noqa: ARG002
        content = json.loads(record.payload)
        values = {str(k): str(v) for k, v in content["values"].items()}
        self._file.metadata(str(content["name"]), values)
        self._derivers.metadata(str(content["name"]), values)

    def _attachment(self, client: _Client, record: Record) -> None:  # noqa: ARG002
        head, separator, data = record.payload.partition(b"\n")
        if not separator:
            raise ValueError("attachment without a head line")
        content = json.loads(head)
        name = str(content["name"])
        self._file.attachment(name, str(content["media_type"]), record.log_time_ns, data)
        self._derivers.attachment(name, data)

    def _losses(self, client: _Client, record: Record) -> None:
        content = json.loads(record.payload)
        client.name, dropped = str(content["client"]), int(content["dropped"])
        before = self.statistics.dropped.get(client.name, 0)
        self.statistics.dropped[client.name] = max(before, dropped)
        if dropped > before:
            text = f"{client.name} dropped {dropped} records so far: the recorder did not keep up"
            self.event(Severity.WARN, text)

    def _goodbye(self, client: _Client, record: Record) -> None:  # noqa: ARG002
        client.goodbye = True

    def _invalid(self, client: _Client, text: str) -> None:
        self.statistics.invalid += 1
        if self.statistics.invalid <= 20:  # the first 20 texts show the cause; all records are counted
            self.event(Severity.ERROR, f"{client.name}: {text}")
