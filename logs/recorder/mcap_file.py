"""The MCAP file of one flight: ROS 2 profile, one channel per topic, readable after any end.

Every channel is CDR with a ros2msg schema and the file has the profile "ros2", which is what rosbag2,
Foxglove, Rerun and PlotJuggler open without further information (MCAP format registry, profile "ros2").

The package's own writer spends two thirds of the recorder's time on building one message record from seven
small pieces and a dataclass. Here a message is one ``struct`` call; everything rare is still written by the
records of the ``mcap`` package, and its readers check the result in the tests.
"""

from __future__ import annotations

import contextlib
import os
import struct
import tempfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame  # type: ignore[import-untyped]
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from logs.schema.schemas import schema_text, type_hash

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_OVERHEAD = 22  # bytes of a message record besides its data
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_BLOCK_BYTES = 2**18  # of index records compressed at a time
_FOOTER_LENGTH = 8 + 8 + 4  # the part of the footer its checksum covers begins with opcode and length


class _PackedRecords:
    """Encoded records kept for the summary, compressed in blocks: ten hours of chunks are 10^5 records."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._open = bytearray()
        self.count = 0
        self.size = 0  # bytes, uncompressed

    def append(self, record: bytes) -> None:
        self._open += record
        self.count += 1
        self.size += len(record)
        if len(self._open) > _BLOCK_BYTES:
            self._blocks.append(zlib.compress(self._open, 1))
            self._open.clear()

    def __iter__(self) -> Iterator[bytes]:
        for block in self._blocks:
            yield zlib.decompress(block)
        if self._open:
            yield bytes(self._open)


class ChunkedWriter:
    """Writes one MCAP file; not thread-safe."""

    def __init__(self, output: SafeStream | BinaryIO, chunk_bytes: int) -> None:
        """Write to ``output``; a chunk is closed when it holds more than ``chunk_bytes`` uncompressed."""
        self._output = output
        self._crc = 0  # of everything written before the end of the data
        self._chunk_bytes = chunk_bytes
        self._chunk = bytearray()
        self._entries: dict[int, list[int]] = {}  # channel -> log time, offset, log time, offset, ...
        self._counts: dict[int, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks = _PackedRecords()
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []

    def start(self, profile: str, library: str) -> None:
        self._write(MCAP0_MAGIC + _encoded(Header(profile, library)))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._chunk += _encoded(schema)
        self._schemas.append(schema)
        return len(self._schemas)

    def register_channel(self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]) -> int:
        number = len(self._channels) + 1
        channel = Channel(number, topic, encoding, dict(metadata), schema)
        self._chunk += _encoded(channel)
        self._channels.append(channel)
        self._entries[number] = []
        self._counts[number] = 0
        return number

    def add_message(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes
    ) -> None:
        chunk = self._chunk
        self._entries[channel] += (log_time_ns, len(chunk))
        length = _MESSAGE_OVERHEAD + len(data)
        chunk += _MESSAGE.pack(_MESSAGE_OPCODE, length, channel, sequence, log_time_ns, publish_time_ns)
        chunk += data
        if len(chunk) > self._chunk_bytes:
            self.flush()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        data = _encoded(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(self._output.tell(), len(data), name))
        self._write(data)

    def add_attachment(
        self, log_time_ns: int, name: str, media_type: str, content: bytes, create_time_ns: int | None = None
    ) -> None:
        """Write a file into the file; without a time of creation that is the log time."""
        created_ns = log_time_ns if create_time_ns is None else create_time_ns
        data = _encoded(Attachment(created_ns, log_time_ns, name, media_type, content))
        at = self._output.tell()
        self._attachments.append(
            AttachmentIndex(at, len(data), log_time_ns, created_ns, len(content), name, media_type)
        )
        self._write(data)

    @property
    def index_bytes(self) -> int:
        """Size of the part of the summary that grows with the file."""
        return self._chunks.size

    def flush(self) -> None:
        """Close the open chunk, if it holds a message, and write it."""
        entries = {channel: flat for channel, flat in self._entries.items() if flat}
        if not entries:
            return
        raw = bytes(self._chunk)
        start_ns = min(min(flat[0::2]) for flat in entries.values())
        end_ns = max(max(flat[0::2]) for flat in entries.values())
        packed = lz4.frame.compress(raw)
        chunk = _encoded(Chunk("lz4", packed, end_ns, start_ns, zlib.crc32(raw), len(raw)))
        at = self._output.tell()
        self._write(chunk)
        offsets: dict[int, int] = {}
        index = bytearray()
        for channel, flat in entries.items():
            offsets[channel] = at + len(chunk) + len(index)
            size = 8 * len(flat)
            index += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size)
            index += struct.pack(f"<{len(flat)}Q", *flat)
            self._counts[channel] += len(flat) // 2
        self._write(bytes(index))
        entry = ChunkIndex(
            chunk_length=len(chunk),
            chunk_start_offset=at,
            compression="lz4",
            compressed_size=len(packed),
            message_end_time=end_ns,
            message_index_length=len(index),
            message_index_offsets=offsets,
            message_start_time=start_ns,
            uncompressed_size=len(raw),
        )
        self._chunks.append(_encoded(entry))
        self._start_ns = start_ns if self._start_ns is None else min(self._start_ns, start_ns)
        self._end_ns = max(self._end_ns, end_ns)
        self._chunk.clear()
        self._entries = {channel: [] for channel in self._entries}

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._output.write(data)

    def finish(self) -> None:
        self.flush()
        self._output.write(_encoded(DataEnd(self._crc)))
        start = self._output.tell()
        crc = 0
        offsets = bytearray()
        groups: tuple[tuple[Opcode, Iterable[bytes]], ...] = (
            (Opcode.SCHEMA, map(_encoded, self._schemas)),
            (Opcode.CHANNEL, map(_encoded, self._channels)),
            (Opcode.STATISTICS, (_encoded(self._statistics()),)),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, map(_encoded, self._attachments)),
            (Opcode.METADATA_INDEX, map(_encoded, self._metadata)),
        )
        for opcode, records in groups:
            at = self._output.tell()
            for data in records:
                crc = zlib.crc32(data, crc)
                self._output.write(data)
            if length := self._output.tell() - at:
                offsets += _encoded(SummaryOffset(opcode, at, length))
        offsets_at = self._output.tell()
        head = struct.pack("<BQQQ", Opcode.FOOTER, _FOOTER_LENGTH, start, offsets_at)
        crc = zlib.crc32(head, zlib.crc32(offsets, crc))
        self._output.write(bytes(offsets) + _encoded(Footer(start, offsets_at, crc)) + MCAP0_MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts={channel: count for channel, count in self._counts.items() if count},
            chunk_count=self._chunks.count,
            message_count=sum(self._counts.values()),
            message_end_time=self._end_ns,
            message_start_time=self._start_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )


def _encoded(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


CHUNK_BYTES = 256 * 1024  # a killed recorder loses at most the open chunk
# Kept free for the end of the file: the pending chunk, schemas and the index, and more as the index grows.
RESERVE_BYTES = 2 * 2**20
_RESERVE_STEP = 2**20  # by which it grows, so that it does so every ten minutes and not every flush
_QOS = "[]"  # as rosbags writes it: nothing is known about the sender's quality of service


class SafeStream:
    """Unbuffered output that ends at a whole record even if the disk fails.

    The MCAP writer hands over whole records. One that does not fit is cut off again, so the file stays
    readable up to the last whole one. ``tell`` still counts after that, since the writer needs it.
    """

    def __init__(self, raw: BinaryIO, reserve: BinaryIO | None = None) -> None:
        self._raw = raw
        self._reserve = reserve
        self._position = 0
        self._reserved = RESERVE_BYTES
        self._stopped = False
        self.failure = ""  # reason why writing stopped; empty while it works

    def tell(self) -> int:
        return self._position

    def write(self, data: bytes) -> int:
        """Write everything or nothing; after a failure that lasts, nothing."""
        if not self._stopped and not self._try(data):
            if self._reserve is not None:
                self._reserve.close()  # the record that failed, and the end of the file, go where this was
                self._reserve = None
                self._stopped = not self._try(data)
            else:
                self._stopped = True
        self._position += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: every write has left the process already."""

    def descriptor(self) -> int:
        return self._raw.fileno()

    def reserve(self, size: int) -> None:
        """Keep so many bytes free; in steps, and less where the disk has no more."""
        if self._reserve is None or size <= self._reserved:
            return
        self._reserved = size + _RESERVE_STEP
        with contextlib.suppress(OSError):
            os.posix_fallocate(self._reserve.fileno(), 0, self._reserved)

    def close(self) -> None:
        """Close the file and give the reserve back."""
        if self._reserve is not None:
            self._reserve.close()
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


class McapFile:
    """One open flight log."""

    def __init__(self, path: Path, *, stream: SafeStream | None = None) -> None:
        """Create the file; ``stream`` replaces the disk in tests."""
        self.path = path
        self.messages = 0  # messages written so far
        self._stream = stream or SafeStream(path.open("xb", buffering=0), _reserved_space(path.parent))
        self._writer = ChunkedWriter(self._stream, CHUNK_BYTES)
        self._writer.start("ros2", _library())
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    @property
    def failure(self) -> str:
        """Reason why the disk stopped accepting data; empty while it works."""
        return self._stream.failure

    def fail(self, why: str) -> None:
        """Stop writing: the disk has not kept earlier data."""
        self._stream.failure = self._stream.failure or why

    def descriptor(self) -> int:
        """Return the descriptor of the open file, for :class:`logs.recorder.recorder.Syncer`."""
        return self._stream.descriptor()

    def channel(self, topic: str, schema: str) -> int:
        """Return the channel of a topic; senders of the same topic and type share it."""
        number = self._channels.get((topic, schema))
        if number is None:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(
                    schema, "ros2msg", schema_text(schema).encode()
                )
            properties = {"offered_qos_profiles": _QOS, "topic_type_hash": type_hash(schema)}
            number = self._writer.register_channel(topic, "cdr", self._schemas[schema], properties)
            self._channels[topic, schema] = number
        return number

    def write(
        self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, payload: bytes
    ) -> None:
        """Add one message; ignored once the disk is full."""
        if not self._stream.failure:
            self._writer.add_message(channel, log_time_ns, publish_time_ns, sequence, payload)
            self.messages += 1

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._writer.add_metadata(name, values)

    def attachment(self, name: str, media_type: str, log_time_ns: int, data: bytes) -> None:
        """Add a file; ignored once the disk is full."""
        if not self._stream.failure:
            self._writer.add_attachment(log_time_ns, name, media_type, data)

    def flush(self) -> None:
        """Close the open chunk, so that a crash loses nothing written so far."""
        if not self._stream.failure:
            self._writer.flush()
            self._stream.reserve(RESERVE_BYTES + self._writer.index_bytes)

    def close(self) -> None:
        self._writer.finish()
        self._stream.close()


def _reserved_space(directory: Path) -> BinaryIO | None:
    """Return an open nameless file that holds space on the same disk; it vanishes with the process."""
    try:
        reserve = tempfile.TemporaryFile(dir=directory)  # noqa: SIM115
    except OSError:
        return None
    try:
        os.posix_fallocate(reserve.fileno(), 0, RESERVE_BYTES)
    except OSError:  # a disk nearly full, or one that cannot reserve: recording is still worth a try
        reserve.close()
        return None
    return reserve


def _library() -> str:
    try:
        return f"crazyflie-flightstack {version('crazyflie-flightstack')}; mcap {version('mcap')}"
    except PackageNotFoundError:
        return "crazyflie-flightstack"
