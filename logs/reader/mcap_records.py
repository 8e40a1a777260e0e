"""Reads the records of a damaged or complete MCAP file, and reports the place of each unreadable part.

A record is readable if it ends within the file, its kind is known, its fields fill it to the last byte and
its checksum is correct. An unreadable record is omitted. If the length of a record is wrong, reading
continues at the next record that the index of the file contains; without an index it ends there.
"""

from __future__ import annotations

import os
import struct
import zlib
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
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
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream

MAGIC = bytes((0x89, 0x4D, 0x43, 0x41, 0x50, 0x30, 0x0D, 0x0A))  # MCAP specification, "Magic"
_HEAD = struct.Struct("<BQ")  # kind of a record, and the length of its content
_MESSAGE = struct.Struct("<HIQQ")  # fields: channel, sequence number, log time, publish time, without payload
_INDEX = struct.Struct("<HI")  # fields: channel, number of bytes of the entries that follow
_TIME_MAX_NS = 2**63 - 1  # maximum time in ROS 2, whose times are signed
_ENTRY_BYTES = 16  # size of an entry of a message index: log time and offset
_FOOTER_BYTES = _HEAD.size + 20
_NO_CRC = bytes(4)
_COMPRESSIONS = ("", "lz4", "zstd")
_DECLARED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header, Opcode.FOOTER: Footer, Opcode.CHUNK: Chunk, Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata, Opcode.DATA_END: DataEnd, Opcode.STATISTICS: Statistics,
    Opcode.CHUNK_INDEX: ChunkIndex, Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex, Opcode.SUMMARY_OFFSET: SummaryOffset, **_DECLARED,
}  # fmt: skip
_PLACES = {  # records of the index that contain start and length of another record
    ChunkIndex: (Opcode.CHUNK, "chunk_start_offset", "chunk_length"),
    AttachmentIndex: (Opcode.ATTACHMENT, "offset", "length"),
    MetadataIndex: (Opcode.METADATA, "offset", "length"),
}


class DamageError(ValueError):
    """An unreadable part of a file."""


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
        """Start a pass over an open file; without ``messages`` they are checked but not yielded."""
        self._stream, self._messages = stream, messages
        self._size = os.fstat(stream.fileno()).st_size
        self._index = _Index(stream, self._size)
        self._declared: dict[tuple[type, int], Any] = {}  # declarations by kind and id
        self._first, self._places = "", 0
        # first unreadable byte; the size of the file if there is none
        self.broken_at = self._size
        self.ended = False  # the footer was read

    @property
    def problem(self) -> str:
        """First unreadable part and its place; empty if everything could be read."""
        more = self._places - 1
        return self._first + (f"; so in {more} more place{'s' * (more > 1)}" if more > 0 else "")

    def __iter__(self) -> Iterator[Any]:
        """Yield the readable records, including those in chunks, in the order in which they were written."""
        at = len(MAGIC)
        crc: int | None = zlib.crc32(
            MAGIC
        )  # CRC of all bytes so far, or of the summary after the data; None: unknown
        self._stream.seek(at)
        while not self.ended:
            head = self._stream.read(_HEAD.size)
            kind, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0)
            end, fence = at + _HEAD.size + length, self._index.after(at)
            if not kind or end > fence:
                reason = "it ends inside a record" if end > fence else _why_no_record(head)
                if fence == self._size:
                    self._damaged(at, f"nothing after byte {at} of {self._size} can be read", reason)
                    return
                self._damaged(at, self._span(at, fence), reason)
                at, crc = fence, None
                self._stream.seek(at)
                continue
            body = self._stream.read(length)
            try:
                yield from self._taken(kind, body, at)
                if kind in (Opcode.DATA_END, Opcode.FOOTER):
                    _check_crc(crc if kind == Opcode.DATA_END or crc is None else zlib.crc32(head, crc), body)
            except Exception as error:  # a library may raise any exception for damaged bytes
                self._damaged(at, self._span(at, end), _reason(error))
            if crc is not None:
                crc = 0 if kind == Opcode.DATA_END else zlib.crc32(body, zlib.crc32(head, crc))
            at = end
        if self._stream.read(len(MAGIC) + 1) != MAGIC:
            self._damaged(at, self._span(at, self._size), "the closing magic is needed there")

    def _span(self, at: int, end: int) -> str:
        return f"bytes {at} to {end} of {self._size} cannot be read"

    def _damaged(self, at: int, what: str, reason: str) -> None:
        if not self._places:
            self._first, self.broken_at = f"{what} ({reason})", at
        self._places += 1

    def _taken(self, kind: int, body: bytes, at: int) -> list[Any]:
        """Return the records of a file record: itself, or the records in a chunk."""
        if kind == Opcode.MESSAGE or kind in _DECLARED:
            return self._in_chunk(_HEAD.pack(kind, len(body)) + body, at)
        record = _understood(kind, body)
        if isinstance(record, Chunk):
            return self._in_chunk(_unpacked(record), at)
        self.ended = self.ended or isinstance(record, Footer)
        return [] if record is None else [record]

    def _in_chunk(self, data: bytes, place: int) -> list[Any]:
        """Return the records in the data of a chunk, in a tenth of the package's time."""
        found: list[Any] = []
        unknown: Counter[int] = Counter()  # number of messages by channel
        at, size = 0, len(data)
        while at < size:
            kind, length = _HEAD.unpack_from(data, at) if size - at >= _HEAD.size else (0, size)
            begin = at + _HEAD.size
            end = begin + length
            if end > size:
                what = f"the chunk at byte {place} cannot be read behind its byte {at}"
                self._damaged(place, what, "a record is longer than the chunk")
                break
            if kind == Opcode.MESSAGE and length >= _MESSAGE.size:
                channel, sequence, logged_ns, published_ns = _MESSAGE.unpack_from(data, begin)
                if (Channel, channel) not in self._declared and not self._indexed(channel, found):
                    unknown[channel] += 1
                elif logged_ns > _TIME_MAX_NS or published_ns > _TIME_MAX_NS:
                    what = f"a message of channel {channel} at byte {place} cannot be read"
                    self._damaged(place, what, "its time is behind the year 2262")
                elif self._messages:
                    payload = data[begin + _MESSAGE.size : end]
                    found.append(Message(channel, logged_ns, payload, published_ns, sequence))
            else:
                try:
                    self._declare(_understood(kind, data[begin:end], _DECLARED), found)
                except Exception as error:  # a library may raise any exception for damaged bytes
                    self._damaged(place, f"a record at byte {place} cannot be read", _reason(error))
            at = end
        for channel, count in unknown.items():
            what = f"{count} message{'s' * (count > 1)} at byte {place} cannot be read"
            self._damaged(place, what, f"channel {channel} was never declared")
        return found

    def _declare(self, record: Any, found: list[Any]) -> None:
        """Store a declaration; a channel needs its schema, and neither may change."""
        key = (type(record), record.id)
        if self._declared.setdefault(key, record) != record:
            raise DamageError(f"{key[0].__name__} {record.id} is declared a second time, and differs")
        found.append(record)
        if (
            isinstance(record, Channel)
            and record.schema_id
            and (Schema, record.schema_id) not in self._declared
        ):
            raise DamageError(f"schema {record.schema_id} of {record.topic} was never declared")

    def _indexed(self, channel: int, found: list[Any]) -> bool:
        """Whether the summary declares a channel whose own declaration was lost."""
        record = self._index.declared.get((Channel, channel))
        if record is None:
            return False
        for each in (self._index.declared.get((Schema, record.schema_id)), record):
            if each is not None and self._declared.setdefault((type(each), each.id), each) is each:
                found.append(each)
        return True


class _Index:
    """The summary at the end of a file; empty if it is missing or damaged."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.declared: dict[tuple[type, int], Any] = {}
        self._fences = [size]
        end = size - _FOOTER_BYTES - len(MAGIC)
        stream.seek(max(end, 0))
        kind, length, start = struct.unpack_from("<BQQ", stream.read(_FOOTER_BYTES).ljust(_FOOTER_BYTES))
        if kind != Opcode.FOOTER or _HEAD.size + length != _FOOTER_BYTES or not len(MAGIC) < start <= end:
            return
        begins = [(Opcode.DATA_END, start - _HEAD.size - 4, _HEAD.size + 4)]
        stream.seek(start)
        data, at = stream.read(end - start), 0
        while at + _HEAD.size <= len(data):
            kind, length = _HEAD.unpack_from(data, at)
            body, at = data[at + _HEAD.size : at + _HEAD.size + length], at + _HEAD.size + length
            try:
                record = _understood(kind, body)
            except Exception:  # the pass over the records reports the error
                continue
            if isinstance(record, Schema | Channel):
                self.declared.setdefault((type(record), record.id), record)
            elif type(record) in _PLACES:
                opcode, offset, length_of = _PLACES[type(record)]
                begins.append((opcode, getattr(record, offset), getattr(record, length_of)))
        for opcode, begin, whole in begins:  # an entry is used only if the file has the record there
            if len(MAGIC) <= begin < start:
                stream.seek(begin)
                if stream.read(_HEAD.size) == _HEAD.pack(opcode, max(whole - _HEAD.size, 0)):
                    self._fences.append(begin)
        self._fences.sort()

    def after(self, at: int) -> int:
        """Return the start of the next known record, or the end of the file."""
        return self._fences[min(bisect_right(self._fences, at), len(self._fences) - 1)]


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
    if kind == Opcode.ATTACHMENT and (crc := body[-4:]) not in (
        _NO_CRC,
        zlib.crc32(body[:-4]).to_bytes(4, "little"),
    ):
        raise DamageError(f"the checksum of the attachment {record.name!r} is wrong: {crc.hex()}")
    return record


def _check_crc(crc: int | None, body: bytes) -> None:
    """Compare the checksum at the end of the data or of the summary."""
    if crc is not None and body[-4:] not in (_NO_CRC, zlib.crc32(body[:-4], crc).to_bytes(4, "little")):
        raise DamageError("the checksum of what is before is wrong")


def _unpacked(chunk: Chunk) -> bytes:
    """Return the uncompressed data of a chunk after checking its checksum."""
    if chunk.compression not in _COMPRESSIONS:
        raise DamageError(f"compression {chunk.compression!r}, known are lz4, zstd and none")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise DamageError(f"a chunk of {size} bytes instead of {chunk.uncompressed_size}")
    data: bytes = stream.read(size)
    return data


def _why_no_record(head: bytes) -> str:
    if not head:
        return "the recorder did not close it: there is no footer"
    return "it ends inside a record" if len(head) < _HEAD.size else "no record begins with a zero byte"


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, DamageError) else f"{type(error).__name__}: {error}".rstrip(": ")
