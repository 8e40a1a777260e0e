"""The MCAP file of one flight: ROS 2 profile, one channel per topic, readable after any kind of end.

Every channel is CDR with a ros2msg schema and the file has the profile "ros2", which rosbag2, Foxglove, Rerun
and PlotJuggler open without further information (MCAP format registry, profile "ros2").

The writer extends that of the ``mcap`` package, which packs each field of a message separately and needs two
thirds of the recorder's time. Here one ``struct`` call packs a message.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, McapRecord, MessageIndex, Metadata
from mcap.writer import CompressionType, Writer

from logs.schema.schemas import schema_text, type_hash

_MESSAGE = struct.Struct("<BQHIQQ")  # fields: opcode, length, channel, sequence, log time, publish time
_MESSAGE_OVERHEAD = 22  # bytes of a message record besides its data
_MESSAGE_OPCODE = int(Opcode.MESSAGE)


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
        # attributes of the package's writer; its version is pinned
        self._chunk, self._counts = self._Writer__chunk_builder, self._Writer__statistics
        self.start("ros2", _library())
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    @property
    def messages(self) -> int:
        """Number of messages written so far."""
        return int(self._counts.message_count)

    @property
    def failure(self) -> str:
        """Reason why the disk stopped accepting data; empty as long as the disk works."""
        return self._output.failure

    def fail(self, why: str) -> None:
        """Stop writing: the disk has lost earlier data."""
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
        """Add one message; ignored once the disk is full."""
        if self._output.failure:
            return
        chunk, counts = self._chunk, self._counts
        index = chunk.message_indices.get(channel)
        if index is None:
            index = chunk.message_indices[channel] = MessageIndex(channel, [])
        buffer = chunk.record_writer._buffer
        index.records.append((log_time_ns, buffer.tell()))
        length = _MESSAGE_OVERHEAD + len(payload)
        buffer.write(_MESSAGE.pack(_MESSAGE_OPCODE, length, channel, sequence, log_time_ns, publish_time_ns))
        buffer.write(payload)
        if not chunk.num_messages or log_time_ns < chunk.message_start_time:
            chunk.message_start_time = log_time_ns
        if log_time_ns > chunk.message_end_time:
            chunk.message_end_time = log_time_ns
        if not counts.message_count or log_time_ns < counts.message_start_time:
            counts.message_start_time = log_time_ns
        if log_time_ns > counts.message_end_time:
            counts.message_end_time = log_time_ns
        counts.channel_message_counts[channel] += 1
        counts.message_count += 1
        chunk.num_messages += 1
        if buffer.tell() > CHUNK_BYTES:
            self.flush()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        _encodable(Metadata(name, dict(values)))
        self.add_metadata(name, dict(values))

    def attachment(self, name: str, media_type: str, log_time_ns: int, data: bytes) -> None:
        """Add a file; ignored once the disk is full."""
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
    """Raise an error before the writer has stored a part of a record that cannot be encoded."""
    record.write(RecordBuilder())


def _library() -> str:
    try:
        return f"crazyflie-flightstack {version('crazyflie-flightstack')}; mcap {version('mcap')}"
    except PackageNotFoundError:
        return "crazyflie-flightstack"
