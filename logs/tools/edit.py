"""New logs out of old ones: recovered, cut in time, or with fewer topics. The old one may be broken.

What is copied is copied to the byte: payloads, schemas, channel properties, metadata, attachments. The index
and the statistics are made anew. A metadata record ``log_tool`` tells what was done.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.records import Message as MessageRecord

from logs.reader.reader import LogFile
from logs.recorder.mcap_file import CHUNK_BYTES
from logs.recorder.mcap_writer import ChunkedWriter
from logs.schema.schemas import TF_MESSAGE, typestore
from logs.tools.file import new_file
from logs.tools.info import Info, gather

LOG_TOOL = "log_tool"  # metadata: which command made this file, from what
SLOW_HZ = 2.0  # topics slower than this are repeated at the start of a cut, as latched ones are
LATCHED = frozenset({"/tf_static"})


@dataclass(frozen=True, slots=True)
class Edited:
    """What a tool wrote.

    Attributes:
        messages: In the new file, repeated ones included.
        repeated: Messages from before a cut, given again at its start.
        problem: What of the old file could not be read; empty when it was whole.
    """

    messages: int
    repeated: int
    problem: str


def recover(log: LogFile, out: Path, *, force: bool = False) -> Edited:
    """Write a whole file with every message that can be read.

    Raises:
        OSError: ``out`` exists, or cannot be written.
    """
    return _copy(log, out, force, "recover", {})


def select(log: LogFile, patterns: Sequence[str], out: Path, *, force: bool = False) -> Edited:
    """Write only the topics that match a pattern; ``*`` stands for any text, ``?`` for a character.

    Raises:
        ValueError: A pattern matches no topic.
        OSError: ``out`` exists, or cannot be written.
    """
    topics = [t.topic for t in gather(log).topics]
    for pattern in patterns:
        if not any(fnmatchcase(topic, pattern) for topic in topics):
            raise ValueError(f"no topic matches {pattern!r}; {log.path} holds {', '.join(topics) or 'none'}")

    wanted = {topic for topic in topics if any(fnmatchcase(topic, pattern) for pattern in patterns)}
    return _copy(log, out, force, "filter", {"topics": " ".join(patterns)}, wanted)


def cut(log: LogFile, begin_s: float, end_s: float | None, out: Path, *, force: bool = False) -> Edited:
    """Write what happened in a span of log time, counted from the first message.

    The last message of each slow or latched topic before the span is given again at its start, with the log
    time of the start, so that the new file shows what held then.

    Raises:
        ValueError: The span holds no message.
        OSError: ``out`` exists, or cannot be written.
    """
    info = gather(log)
    span = _Span(log, info, begin_s, end_s)
    asked = {"from_s": repr(begin_s), "to_s": repr(info.duration_s if end_s is None else end_s)}
    return _copy(log, out, force, "cut", asked, span=span)


class _Span:
    """Decides what a cut does with each message."""

    def __init__(self, log: LogFile, info: Info, begin_s: float, end_s: float | None) -> None:
        self._begin_ns = info.start_ns + round(begin_s * 1e9)
        self._end_ns = info.end_ns if end_s is None else info.start_ns + round(end_s * 1e9)
        if not info.messages or self._begin_ns > min(info.end_ns, self._end_ns) or begin_s < 0.0:
            to = "its end" if end_s is None else f"{end_s:g} s"
            raise ValueError(
                f"nothing lies from {begin_s:g} s to {to}: {log.path} holds {info.messages} messages "
                f"from 0 to {info.duration_s:.3f} s"
            )
        few = 1.0 + SLOW_HZ * info.duration_s  # events come in bunches: the mean over the whole log counts
        self._slow = {t.topic for t in info.topics if t.messages <= few} | LATCHED
        self._channels: dict[int, tuple[str, bool]] = {}
        self._held: dict[tuple[int, Any], MessageRecord] = {}
        self._started = False
        self.repeated = 0

    def declare(self, channel: Channel, schema: str) -> None:
        static = channel.topic in LATCHED and schema == TF_MESSAGE
        self._channels[channel.id] = (channel.topic, static)

    def place(self, message: MessageRecord) -> list[MessageRecord]:
        """Return what to write at this place of the file."""
        if message.log_time > self._end_ns:
            return []
        if message.log_time >= self._begin_ns:
            return [*self.rest(), message]
        topic, static = self._channels[message.channel_id]
        if topic in self._slow:
            self._held[message.channel_id, _frames(message) if static else None] = message
        return self.rest() if self._started else []

    def rest(self) -> list[MessageRecord]:
        """Return what is held, to be written now."""
        self._started = True
        held = [replace(message, log_time=self._begin_ns) for message in self._held.values()]
        self._held.clear()
        self.repeated += len(held)
        return held


def _frames(message: MessageRecord) -> tuple[str, ...]:
    """Return the child frames of transforms: each publisher of /tf_static latches its own."""
    try:
        decoded = typestore().deserialize_cdr(message.data, TF_MESSAGE)
    except Exception:  # a library raises whatever it likes about damaged bytes; they are copied as they are
        return (message.data.hex(),)
    return tuple(t.child_frame_id for t in decoded.transforms)


def _copy(
    log: LogFile, out: Path, force: bool, command: str, asked: dict[str, str],
    wanted: Collection[str] | None = None, span: _Span | None = None,
) -> Edited:  # fmt: skip
    """Copy the wanted topics, all by default, as far as the span wants their messages."""
    with new_file(out, force=force) as part:
        with part.open("wb") as stream:
            copier = _Copier(ChunkedWriter(stream, CHUNK_BYTES), wanted, span)
            for record in log.records():
                copier.take(record)
            problem = log.why_broken
            told = {"source": log.path.name, "source_problem": problem}
            copier.end({"command": command, **asked, **told})
        return Edited(copier.messages, span.repeated if span else 0, problem)


class _Copier:
    """Writes records of one file into another, with numbers of its own for schemas and channels."""

    def __init__(self, writer: ChunkedWriter, wanted: Collection[str] | None, span: _Span | None) -> None:
        self._writer = writer
        self._wanted = wanted
        self._span = span
        self._headed = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int | None] = {}  # None: not wanted
        self._written: dict[tuple[str, str, bytes], int] = {}  # schemas
        self.messages = 0

    def take(self, record: Any) -> None:
        """Write one record, if it is wanted."""
        if not self._headed:
            header = record if isinstance(record, Header) else Header("", "")
            self._writer.start(header.profile, header.library)
            self._headed = True
        if isinstance(record, MessageRecord):
            self._message(record)
        elif isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channel(record)
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.log_time, record.name, record.media_type, record.data, record.create_time
            )

    def end(self, done: dict[str, str]) -> None:
        """Write what is left, what was done, and the index."""
        if not self._headed:
            self._writer.start("", "")
        for message in self._span.rest() if self._span else ():
            self._add(message)
        self._writer.add_metadata(LOG_TOOL, done)
        self._writer.finish()

    def _message(self, message: MessageRecord) -> None:
        if self._channels[message.channel_id] is not None:
            for placed in self._span.place(message) if self._span else (message,):
                self._add(placed)

    def _add(self, message: MessageRecord) -> None:
        channel = self._channels[message.channel_id]
        assert channel is not None
        self._writer.add_message(
            channel, message.log_time, message.publish_time, message.sequence, message.data
        )
        self.messages += 1

    def _channel(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return  # the summary says it again
        schema = self._schemas.get(channel.schema_id)
        if self._span:
            self._span.declare(channel, schema.name if schema else "")
        if self._wanted is not None and channel.topic not in self._wanted:
            self._channels[channel.id] = None
            return
        number = 0  # MCAP: a channel without a schema
        if schema is not None:
            key = (schema.name, schema.encoding, schema.data)
            if key not in self._written:
                self._written[key] = self._writer.register_schema(*key)
            number = self._written[key]
        self._channels[channel.id] = self._writer.register_channel(
            channel.topic, channel.message_encoding, number, channel.metadata
        )
