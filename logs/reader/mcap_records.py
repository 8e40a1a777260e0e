"""Reads the readable records of an MCAP file, and reports the first unreadable one.

A record is readable if it ends within the file, its kind is known, its fields fill it to the last byte and
its checksum is correct. Reading continues behind an unreadable record, unless its length is wrong. For a file
of another format, the error names the format and says what to do.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream

MAGIC = bytes((0x89, 0x4D, 0x43, 0x41, 0x50, 0x30, 0x0D, 0x0A))  # first bytes of the file (MCAP, "Magic")
_HEAD = struct.Struct("<BQ")  # kind of a record, and the length of its content
_MESSAGE = struct.Struct("<HIQQ")  # fields: channel, sequence number, log time, publish time, without payload
_INDEX = struct.Struct("<HI")  # fields: channel, number of bytes of the entries that follow
_TIME_MAX_NS = 2**63 - 1  # maximum time in ROS 2, whose times are signed
_ENTRY_BYTES = 16  # size of an entry of a message index: log time and offset
_NO_CRC = bytes(4)
_COMPRESSIONS = ("", "lz4", "zstd")
_DECLARED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.CHUNK: Chunk, Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata, Opcode.DATA_END: DataEnd, Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex, Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.SUMMARY_OFFSET: SummaryOffset, **_DECLARED,
}  # fmt: skip


class DamageError(ValueError):
    """An unreadable record or file; the text says why."""


class _Strict(ReadDataStream):  # type: ignore[misc]
    """Reads the requested bytes or raises: the package's own stream silently returns fewer."""

    def read(self, length: int) -> bytes:
        data: bytes = self._stream.read(length) if length > 0 else b""
        self._count += len(data)
        if len(data) != length:
            raise DamageError("a field is longer than its record")
        return data


class Records:
    """One pass over the records of a file."""

    def __init__(self, stream: BinaryIO, *, messages: bool) -> None:
        """Start a pass over an open file; if ``messages`` is False, messages are checked but not yielded."""
        self._stream, self._messages = stream, messages
        self._size = os.fstat(stream.fileno()).st_size
        self._declared: dict[tuple[type, int], Any] = {}  # declarations by kind and id
        self._repeated: dict[tuple[type, int], Any] | None = None  # declarations in the summary of the file
        self._first, self._places = "", 0  # first unreadable record; number of unreadable records

    @property
    def problem(self) -> str:
        """Kind, place and reason of the first unreadable record; empty if all records are readable."""
        more = self._places - 1
        return self._first + (f"; so in {more} more place{'s' * (more > 1)}" if more > 0 else "")

    def _damaged(self, what: str, error: Exception) -> None:
        if not self._places:
            self._first = f"{what} ({_reason(error)})"
        self._places += 1

    def __iter__(self) -> Iterator[Any]:
        """Yield the readable records, including those in chunks, in the order in which they were written."""
        at, kind = len(MAGIC), -1
        crc = zlib.crc32(MAGIC)  # CRC of all bytes so far, or of the summary after the data
        self._stream.seek(at)
        try:
            while kind != Opcode.FOOTER:
                head = self._stream.read(_HEAD.size)
                kind, length = self._head(head, at)
                body = self._stream.read(length)
                try:
                    yield from self._taken(kind, body, at)
                    if kind in (Opcode.DATA_END, Opcode.FOOTER):
                        _check_crc(crc if kind == Opcode.DATA_END else zlib.crc32(head, crc), body)
                except Exception as error:  # a library may raise any exception for damaged bytes
                    end = at + len(head) + length
                    self._damaged(f"bytes {at} to {end} of {self._size} cannot be read", error)
                crc = 0 if kind == Opcode.DATA_END else zlib.crc32(body, zlib.crc32(head, crc))
                at += len(head) + length
            if self._stream.read(len(MAGIC) + 1) != MAGIC:
                raise DamageError("the closing magic is needed there")
        except DamageError as error:
            self._damaged(f"nothing after byte {at} of {self._size} can be read", error)

    def _head(self, head: bytes, at: int) -> tuple[int, int]:
        """Return the kind of the record at a byte of the file, and the length of its content."""
        if not head:
            raise DamageError("the recorder did not close it: there is no footer")
        kind, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, self._size)
        if at + len(head) + length > self._size:
            raise DamageError("it ends inside a record")
        if not kind:
            raise DamageError("no record begins with a zero byte")
        return kind, length

    def _taken(self, kind: int, body: bytes, place: int) -> list[Any]:
        """Return the records of a chunk, or the record itself if it is no chunk."""
        if kind == Opcode.MESSAGE or kind in _DECLARED:
            return self._in_chunk(_HEAD.pack(kind, len(body)) + body, place)
        record = _understood(kind, body)
        if isinstance(record, Chunk):
            return self._in_chunk(_unpacked(record), place)
        return [] if record is None else [record]

    def _in_chunk(self, data: bytes, place: int) -> list[Any]:
        """Return the records in the data of a chunk; this is ten times faster than the ``mcap`` package."""
        found: list[Any] = []
        at, size = 0, len(data)
        while at < size:
            kind, length = _HEAD.unpack_from(data, at) if size - at >= _HEAD.size else (0, size)
            begin = at + _HEAD.size
            at = begin + length
            try:
                if at > size:
                    raise DamageError("a record is longer than its chunk")
                if kind == Opcode.MESSAGE and length >= _MESSAGE.size:
                    channel, sequence, logged_ns, published_ns = _MESSAGE.unpack_from(data, begin)
                    if (Channel, channel) not in self._declared:
                        self._from_summary(channel, found)
                    if logged_ns > _TIME_MAX_NS or published_ns > _TIME_MAX_NS:
                        raise DamageError(
                            f"the time of a message of channel {channel} is behind the year 2262"
                        )
                    if self._messages:
                        payload = data[begin + _MESSAGE.size : at]
                        found.append(Message(channel, logged_ns, payload, published_ns, sequence))
                else:
                    self._declare(_understood(kind, data[begin:at], _DECLARED), found)
            except Exception as error:  # a library may raise any exception for damaged bytes
                self._damaged(f"a record at byte {place} cannot be read", error)
        return found

    def _from_summary(self, channel: int, found: list[Any]) -> None:
        """Declare a channel from the summary of the file, because its first declaration is unreadable."""
        if self._repeated is None:
            here = self._stream.tell()
            self._stream.seek(0)
            try:
                summary = make_reader(self._stream).get_summary()
            except Exception:  # there is no summary, or it is damaged; the pass itself reports this
                summary = None
            self._stream.seek(here)
            self._repeated = {}
            if summary is not None:
                self._repeated.update(((Schema, number), each) for number, each in summary.schemas.items())
                self._repeated.update(((Channel, number), each) for number, each in summary.channels.items())
        if (record := self._repeated.get((Channel, channel))) is None:
            raise DamageError(f"channel {channel} was never declared")
        schema = self._repeated.get((Schema, record.schema_id))
        for each in filter(None, (schema, record)):
            self._declare(each, found)

    def _declare(self, record: Any, found: list[Any]) -> None:
        """Store and yield a schema or channel; reject a changed one, and a channel without its schema."""
        kind = type(record)
        if self._declared.setdefault((kind, record.id), record) != record:
            raise DamageError(f"{kind.__name__} {record.id} is declared a second time, and differs")
        found.append(record)
        needed = record.schema_id if kind is Channel else 0
        if needed and (Schema, needed) not in self._declared:
            raise DamageError(f"schema {needed} of {record.topic} was never declared")


def _understood(kind: int, body: bytes, kinds: dict[int, Any] = _KINDS) -> Any:
    """Return a complete record; None for a message index, which is not used."""
    if kind == Opcode.MESSAGE_INDEX and kinds is _KINDS:
        if len(body) < _INDEX.size or (len(body) - _INDEX.size) % _ENTRY_BYTES:
            raise DamageError("an index of messages that is not whole")
        return None
    if kind not in kinds:
        raise DamageError(f"a record of kind {kind:#04x} is not known here")
    stream = _Strict(BytesIO(body))
    record = kinds[kind].read(stream)
    if stream.count != len(body):
        raise DamageError(f"{type(record).__name__} has {len(body) - stream.count} unexpected bytes")
    if kind == Opcode.ATTACHMENT:
        _check_crc(0, body)
    return record


def _check_crc(crc: int, body: bytes) -> None:
    """Compare the checksum at the end of a record; ``crc``: checksum of the bytes before the record."""
    if body[-4:] not in (_NO_CRC, zlib.crc32(body[:-4], crc).to_bytes(4, "little")):
        raise DamageError("a checksum is wrong")


def _unpacked(chunk: Chunk) -> bytes:
    """Return the uncompressed data of a chunk after checking its checksum."""
    if chunk.compression not in _COMPRESSIONS:
        raise DamageError(f"compression {chunk.compression!r}, known are lz4, zstd and none")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise DamageError(f"a chunk of {size} bytes instead of {chunk.uncompressed_size}")
    data: bytes = stream.read(size)
    return data


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, DamageError) else f"{type(error).__name__}: {error}".rstrip(": ")


class _Format(NamedTuple):
    begins: bytes | None  # magic bytes; None: the format is recognised by the file name only
    endings: tuple[str, ...]  # file name endings, for damaged files and for formats without magic bytes
    what: str


_OURS = "logs of this stack are needed"
_FORMATS = (
    _Format(
        b"version https://git-lfs", (), "a pointer of Git LFS; fetch the file itself with `git lfs pull`"
    ),
    _Format(b"\x28\xb5\x2f\xfd", (".zst", ".zstd"), "compressed by zstd; unpack it with `zstd -d`"),
    _Format(b"\x04\x22\x4d\x18", (".lz4",), "compressed by lz4; unpack it with `lz4 -d`"),
    _Format(b"\x1f\x8b", (".gz", ".tgz"), "compressed by gzip; unpack it with `gunzip`"),
    _Format(b"BZh", (".bz2",), "compressed by bzip2; unpack it with `bunzip2`"),
    _Format(b"\xfd7zXZ", (".xz",), "compressed by xz; unpack it with `unxz`"),
    _Format(b"PK\x03\x04", (".zip",), "a ZIP archive; unpack it with `unzip`"),
    _Format(
        b"SQLite format 3",
        (".db3",),
        "an SQLite database, as rosbag2 writes .db3; `ros2 bag convert` makes MCAP of it",
    ),
    _Format(b"#ROSBAG V", (".bag",), "a bag of ROS 1; `mcap convert` makes MCAP of it"),
    _Format(b"ULog\x01", (".ulg",), "a ULog of PX4; `validate` and `identify` read logs of this stack only"),
    _Format(b"\xa3\x95", (".bin",), f"a DataFlash log of ArduPilot; {_OURS}"),
    _Format(None, (".tlog",), f"a telemetry log of MAVLink; {_OURS}"),
    _Format(b"FMT, ", (), f"a DataFlash log of ArduPilot as text; {_OURS}"),
    _Format(b"RRF", (".rrd",), "a recording of Rerun; open it with `rerun`, or give the log it was made of"),
    _Format(b"PAR1", (".parquet",), "a table in Parquet; `validate` takes its folder"),
    _Format(b"<", (".html",), "a page of HTML or XML, as of a download that failed; fetch the file again"),
)


def named(path: Path, head: bytes) -> str:
    """Return the format by the magic bytes of a file, or else by the ending of its name."""
    for form in _FORMATS:
        if form.begins is not None and head.startswith(form.begins):
            return f"it is {form.what}"
    begins = f"it begins with {head[:8].hex(' ')}"
    for form in _FORMATS:
        if path.suffix.lower() in form.endings:
            return f"{begins}; by its name it is {form.what}"
    return begins


def no_file(path: Path) -> str:
    """Return the error text for a path that is no file: what it is, and which file is needed."""
    if not path.is_dir():
        return "is a pipe, socket or device; an MCAP file is needed"
    logs = sorted(path.glob("*.mcap"))
    what = "a folder of rosbag2" if (path / "metadata.yaml").is_file() else "a folder"
    return f"is {what}; an MCAP file is needed" + (f", for example {logs[0]}" if logs else "")
