"""Reads the readable records of an MCAP file, and reports the first unreadable record.

The ``mcap`` package stops at the first damage, and reports no problem for a file that it does not understand.
Here reading continues behind an unreadable record, unless the length of the record is wrong.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

MAGIC = bytes((0x89, 0x4D, 0x43, 0x41, 0x50, 0x30, 0x0D, 0x0A))  # first bytes of the file (MCAP, "Magic")
_HEAD = struct.Struct("<BQ")  # fields before a record: kind, and length of its content in bytes
_MESSAGE = struct.Struct("<HIQQ")  # fields before the payload: channel, sequence, log time, publish time
_TIME_MAX_NS = 2**63 - 1  # maximum time in ROS 2, ns; times in ROS 2 are signed
_COMPRESSIONS = ("", "lz4", "zstd")
_NO_CRC = bytes(4)
_DECLARED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
_USED = {
    Opcode.HEADER: Header, Opcode.CHUNK: Chunk, Opcode.ATTACHMENT: Attachment, Opcode.METADATA: Metadata,
    **_DECLARED,
}  # fmt: skip


class DamageError(ValueError):
    """An unreadable record or file; the text contains the reason."""


class Records:
    def __init__(self, stream: BinaryIO, *, messages: bool) -> None:
        """Start a pass over an open file; if ``messages`` is False, messages are checked but not yielded."""
        self._stream, self._messages = stream, messages
        self._size = os.fstat(stream.fileno()).st_size
        self._declared: dict[tuple[type, int], Any] = {}  # schemas and channels by type and id
        self._first, self._places = "", 0  # first problem, as text; number of problems

    @property
    def problem(self) -> str:
        """Place and reason of the first unreadable record; empty if all records are readable."""
        more = self._places - 1
        return self._first + (f"; so in {more} more place{'s' * (more > 1)}" if more > 0 else "")

    def _damaged(self, what: str, error: Exception) -> None:
        if not self._places:
            named = "" if isinstance(error, DamageError) else f"{type(error).__name__}: "
            self._first = f"{what} ({named}{error})".replace(": )", ")")
        self._places += 1

    def __iter__(self) -> Iterator[Any]:
        """Yield the readable records, including those in chunks, in the order in which they were written."""
        at, kind, size = len(MAGIC), -1, self._size
        crc = zlib.crc32(MAGIC)  # checksum of all bytes so far
        yield from self._repeated()
        self._stream.seek(at)
        try:
            while kind != Opcode.FOOTER:
                head = self._stream.read(_HEAD.size)
                kind, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, size)
                end = at + _HEAD.size + length
                if end > size:
                    raise DamageError("the recorder did not close it, or it was cut")
                if not kind:
                    raise DamageError("no record begins with a zero byte")
                body = self._stream.read(length)
                try:
                    yield from self._taken(kind, body, f"byte {at}")
                    if kind == Opcode.DATA_END and body[:4] not in (_NO_CRC, crc.to_bytes(4, "little")):
                        raise DamageError("the checksum of the data is wrong")
                except Exception as error:  # a library may raise any exception for damaged bytes
                    self._damaged(f"bytes {at} to {end} of {size} cannot be read", error)
                crc = zlib.crc32(body, zlib.crc32(head, crc))
                at = end
            if self._stream.read(len(MAGIC) + 1) != MAGIC:
                raise DamageError("the closing magic is needed there")
        except DamageError as error:
            self._damaged(f"nothing after byte {at} of {size} can be read", error)

    def _taken(self, kind: int, body: bytes, place: str) -> list[Any]:
        """Return the records in a chunk, or the record itself; an empty list for a record of the summary."""
        if kind == Opcode.MESSAGE:
            return self._in_chunk(_HEAD.pack(kind, len(body)) + body, place)
        if kind not in _USED:
            Opcode(kind)
            return []
        record = _USED[kind].read(ReadDataStream(BytesIO(body)))
        if isinstance(record, Chunk):
            return self._in_chunk(_unpacked(record), place)
        return self._declare(record) if kind in _DECLARED else [record]

    def _in_chunk(self, data: bytes, place: str) -> list[Any]:
        """Return the records in the data of a chunk, ten times faster than the ``mcap`` package does."""
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
                        raise DamageError(f"channel {channel} was never declared")
                    if logged_ns > _TIME_MAX_NS or published_ns > _TIME_MAX_NS:
                        raise DamageError(f"a message of channel {channel} is behind the year 2262")
                    if self._messages:
                        payload = data[begin + _MESSAGE.size : at]
                        found.append(Message(channel, logged_ns, payload, published_ns, sequence))
                elif kind not in _DECLARED:
                    raise DamageError(f"a record of kind {kind:#04x} is not known here")
                else:
                    found += self._declare(_DECLARED[kind].read(ReadDataStream(BytesIO(data[begin:at]))))
            except Exception as error:  # a library may raise any exception for damaged bytes
                self._damaged(f"a record at {place} cannot be read", error)
        return found

    def _repeated(self) -> Iterator[Any]:
        """Yield the declarations that the summary repeats, because the originals may be unreadable."""
        with suppress(Exception):  # a missing or damaged summary is reported by the later pass
            summary = make_reader(self._stream, validate_crcs=True).get_summary()
            for record in (*summary.schemas.values(), *summary.channels.values()):
                yield from self._declare(record)

    def _declare(self, record: Any) -> list[Any]:
        """Store and return a schema or channel; reject changed declarations, and channels without schema."""
        kind = type(record)
        needed = record.schema_id if kind is Channel else 0
        if needed and (Schema, needed) not in self._declared:
            raise DamageError(f"schema {needed} of {record.topic} was never declared")
        if self._declared.setdefault((kind, record.id), record) != record:
            raise DamageError(f"{kind.__name__} {record.id} is declared a second time, and differs")
        return [record]


def _unpacked(chunk: Chunk) -> bytes:
    """Return the uncompressed data of a chunk after checking its checksum."""
    if chunk.compression not in _COMPRESSIONS:
        raise DamageError(f"compression {chunk.compression!r}, known are lz4, zstd and none")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if size != chunk.uncompressed_size:
        raise DamageError(f"a chunk of {size} bytes instead of {chunk.uncompressed_size}")
    data: bytes = stream.read(size)
    return data


_FORMATS = {
    b"version https://git-lfs": "a pointer of Git LFS; fetch the file itself with `git lfs pull`",
    b"\x28\xb5\x2f\xfd": "compressed by zstd; unpack it with `zstd -d`",
    b"\x04\x22\x4d\x18": "compressed by lz4; unpack it with `lz4 -d`",
    b"\x1f\x8b": "compressed by gzip; unpack it with `gunzip`",
    b"SQLite format 3": "an SQLite database, as rosbag2 writes .db3; `ros2 bag convert` makes MCAP of it",
    b"#ROSBAG V": "a bag of ROS 1; `mcap convert` makes MCAP of it",
    b"ULog\x01": "a ULog of PX4; logs of this stack are needed",
    b"\xa3\x95": "a DataFlash log of ArduPilot; logs of this stack are needed",
}


def named(head: bytes) -> str:
    known = (f"it is {what}" for begins, what in _FORMATS.items() if head.startswith(begins))
    return next(known, f"it begins with {head[:8].hex(' ')}")
