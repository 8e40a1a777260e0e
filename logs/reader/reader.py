"""Read a flight log, whole or broken; of a fleet's log all of it, or the part of one member.

A recorder that was killed leaves a file without its index, cut at any byte. Everything before the cut is
read; only the last, unfinished chunk is lost. Readers that want the index refuse such a file.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment as AttachmentRecord
from mcap.records import Channel, Chunk, Footer, MessageIndex, Metadata, Schema
from mcap.records import Message as MessageRecord
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream

from logs.reader.members import Members, MemberView
from logs.schema.schemas import store_for

_MAGIC = bytes((0x89, 0x4D, 0x43, 0x41, 0x50, 0x30, 0x0D, 0x0A))  # MCAP specification, "Magic"
_HEAD = struct.Struct("<BQ")  # of a record: its kind and the length of what follows
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence number, log time, publish time; then the payload
_DECLARED = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
_INDEX = MessageIndex(0, [])
_BROKEN = (McapError, struct.error, ValueError, OverflowError, EOFError, RuntimeError, KeyError, MemoryError)


class LogError(ValueError):
    """A file that cannot be used as a flight log; says what was found and what is needed."""


class Message(NamedTuple):
    """One recorded message."""

    topic: str
    schema: str
    log_time_ns: int  # Unix time; simulated time from 2020-01-01 on in lockstep
    publish_time_ns: int
    sequence: int
    data: bytes  # CDR with its four-byte header

    def decode(self) -> Any:
        """Return the message as an object with the fields of its definition (slow path, by ``rosbags``)."""
        return store_for(self.schema).deserialize_cdr(self.data, self.schema)


class Attachment(NamedTuple):
    """One file kept inside the log."""

    name: str
    media_type: str
    log_time_ns: int
    data: bytes


class _Outline(NamedTuple):
    """What one pass over the records outside the chunks gives."""

    metadata: dict[str, dict[str, str]]
    attachments: list[Attachment]
    complete: bool
    problem: str


class LogFile:
    """A flight log on disk, or what it holds of one member of a fleet as the log of a single flight.

    Attributes:
        path: Where it is.
        member: Whose part is seen; None: everything.
        problem: Why the last pass ended early; empty when it did not.
        broken_at: Bytes from the start up to which the last pass could read; the size of a whole file.
    """

    def __init__(self, path: Path | str, member: str | None = None) -> None:
        """Look at the head of the file.

        Args:
            path: Where it is.
            member: Namespace of a member of a fleet: only its topics, events, metadata and attachments are
                seen, under the names that they have in the log of a single flight, and what belongs to all.

        Raises:
            LogError: Missing, empty, not an MCAP file, or without such a member.
        """
        self.path = Path(path)
        self.member = member
        self.problem = ""
        self.broken_at = 0
        try:
            with self.path.open("rb") as stream:
                head = stream.read(len(_MAGIC))
        except OSError as error:
            raise LogError(f"cannot open the log {self.path}: {error.strerror}") from error
        if not head:
            raise LogError(f"{self.path} is empty; expected an MCAP file")
        if head != _MAGIC:
            raise LogError(f"{self.path} is not an MCAP file: it begins with {head.hex(' ')}")
        if member is not None and member not in (names := self.parts.names):
            holds = f"a fleet of {', '.join(names)}" if names else "one flight, without members"
            raise LogError(f"{self.path} has no member {member!r}; it holds {holds}")

    @property
    def members(self) -> tuple[str, ...]:
        """Namespaces of the members of a fleet; () for one flight, as for the part of one member."""
        return self.parts.names if self.member is None else ()

    def single(self) -> LogFile:
        """Return this log where it is one flight.

        Raises:
            LogError: It is a fleet's; names the members.
        """
        if self.members:
            raise LogError(
                f"{self.path} holds a fleet of {', '.join(self.members)}; say whose flight, for example with "
                f"--member {self.members[0]}"
            )
        return self

    @property
    def complete(self) -> bool:
        """Whether the recorder closed the file properly and every byte before the end could be read."""
        return self._outline.complete

    @property
    def why_broken(self) -> str:
        """Where and why a log that is not complete ends; empty for one that is."""
        if self.complete:
            return ""
        return self._outline.problem or "the recorder did not close it"

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """Yield the messages in the order they were written, up to the end or the break.

        Args:
            topics: Only these; None for all.
        """
        channels: dict[int, Channel] = {}
        schemas: dict[int, str] = {}
        for record in self.records():
            if isinstance(record, MessageRecord):
                channel = channels[record.channel_id]
                if topics is None or channel.topic in topics:
                    yield Message(
                        channel.topic, schemas.get(channel.schema_id, ""),
                        record.log_time, record.publish_time, record.sequence, record.data,
                    )  # fmt: skip
            elif isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                channels[record.id] = record

    def records(self) -> Iterator[Any]:
        """Yield the MCAP records, those in chunks included, in the order they were written, up to a break.

        A message never comes before its channel. Schemas and channels come again from the summary.
        """
        records = self._whole()
        return records if self.view is None else _seen(records, self.view)

    def _whole(self) -> Iterator[Any]:
        known: set[int] = set()
        for record in self._records(inside_chunks=True):
            if isinstance(record, Channel):
                known.add(record.id)
            elif isinstance(record, MessageRecord) and record.channel_id not in known:
                self.problem = f"a message on channel {record.channel_id}, which was never declared"
                return
            yield record

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records by name; of several with one name the last value of each key."""
        view, found = self.view, self._outline.metadata
        if view is None:
            return found
        return {
            seen: view.values(seen, values)
            for name, values in found.items()
            if (seen := view.name(name)) is not None
        }

    def attachments(self) -> list[Attachment]:
        """Return the files kept inside the log, in the order they were written."""
        view, found = self.view, self._outline.attachments
        if view is None:
            return found
        return [each._replace(name=seen) for each in found if (seen := view.name(each.name)) is not None]

    def attachment(self, name: str) -> bytes | None:
        """Return the last file of this name, ``None`` if there is none."""
        return next((each.data for each in reversed(self.attachments()) if each.name == name), None)

    @cached_property
    def parts(self) -> Members:
        """Whose part of the file is whose."""
        return Members(self._outline.metadata)

    @cached_property
    def view(self) -> MemberView | None:
        """What of the file is the member's; None without one."""
        return None if self.member is None else MemberView(self.parts, self.member)

    @cached_property
    def _outline(self) -> _Outline:
        metadata: dict[str, dict[str, str]] = {}
        attachments: list[Attachment] = []
        ended = False
        for record in self._records(inside_chunks=False):
            if isinstance(record, Metadata):
                metadata.setdefault(record.name, {}).update(record.metadata)
            elif isinstance(record, AttachmentRecord):
                attachments.append(Attachment(record.name, record.media_type, record.log_time, record.data))
            ended = ended or isinstance(record, Footer)
        return _Outline(metadata, attachments, ended and not self.problem, self.problem)

    def _records(self, inside_chunks: bool) -> Iterator[Any]:
        """Yield MCAP records; stop without an exception where the file breaks, and remember where and why."""
        self.problem = ""
        with self.path.open("rb") as stream:
            # A length field that was never filled in must not make us ask for that much memory.
            size = max(os.fstat(stream.fileno()).st_size, 1)
            records = _Records(stream, emit_chunks=True, record_size_limit=size).records
            while True:
                self.broken_at = stream.tell()
                try:
                    record = next(records, None)
                    if record is None:
                        self.broken_at = size  # behind the last record there is the closing magic
                        return
                    inner = _opened(record, inside_chunks)
                except _BROKEN as error:
                    reason = f"{type(error).__name__}: {error}".rstrip(": ")
                    self.problem = f"nothing after byte {self.broken_at} of {size} can be read ({reason})"
                    return
                yield from inner


def _seen(records: Iterable[Any], view: MemberView) -> Iterator[Any]:
    """Yield what a member has of the records, under the names of a single flight."""
    schemas: dict[int, str] = {}
    channels: dict[int, str] = {}  # schema of each channel that is seen
    for record in records:
        if isinstance(record, MessageRecord):
            schema = channels.get(record.channel_id)
            data = None if schema is None else view.data(schema, record.data)
            if data is None:
                continue
            yield record if data is record.data else replace(record, data=data)
            continue
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            topic = view.topic(record.topic)
            if topic is None:
                continue
            record = replace(record, topic=topic)
            channels[record.id] = schemas.get(record.schema_id, "")
        elif isinstance(record, Metadata | AttachmentRecord):
            name = view.name(record.name)
            if name is None:
                continue
            record = replace(record, name=name)
        yield record


def _opened(record: Any, inside_chunks: bool) -> Sequence[Any]:
    """Return the records in a chunk, or the record itself; checks the chunk's CRC either way."""
    if not isinstance(record, Chunk):
        return (record,)
    stream, size = get_chunk_data_stream(record, validate_crc=True)
    return _in_chunk(stream.read(size), record) if inside_chunks else ()


def _in_chunk(data: bytes, chunk: Chunk) -> Sequence[Any]:
    """Return the records in the data of a chunk, as ``breakup_chunk`` does in ten times the time.

    What is not as it should be is left to that function, which says what is wrong.
    """
    found: list[Any] = []
    at, size = 0, len(data)
    while at < size - _HEAD.size:
        kind, length = _HEAD.unpack_from(data, at)
        begin = at + _HEAD.size
        at = begin + length
        if at > size:
            break
        if kind == Opcode.MESSAGE and length >= _MESSAGE.size:
            channel, sequence, logged_ns, published_ns = _MESSAGE.unpack_from(data, begin)
            payload = data[begin + _MESSAGE.size : at]
            found.append(MessageRecord(channel, logged_ns, payload, published_ns, sequence))
        elif kind in _DECLARED:
            found.append(_DECLARED[kind].read(ReadDataStream(BytesIO(data[begin:at]))))
        else:
            break
    return found if at == size else breakup_chunk(chunk, validate_crc=True)


class _Records(StreamReader):  # type: ignore[misc]
    """Reads records without the entries of message indices, which nobody asks for and which take as long."""

    def _read_record(self, opcode: int, length: int) -> Any:
        if opcode == Opcode.MESSAGE_INDEX:
            self._stream.read(length)
            return _INDEX
        return super()._read_record(opcode, length)


def open_log(path: Path | str) -> Iterator[Message]:
    """Yield every message of a log, whole or broken, in the order it was written.

    Raises:
        LogError: Missing, empty, or not an MCAP file.
    """
    return LogFile(path).messages()
