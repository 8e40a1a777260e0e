"""A whole log out of a broken one.

What can be read is copied to the byte: payloads, schemas, channel properties, metadata, attachments. Index
and statistics are made anew. A metadata record ``log_tool`` names the command and the source.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.records import Message as MessageRecord

from logs.reader.reader import LogFile
from logs.recorder.mcap_file import CHUNK_BYTES, ChunkedWriter
from logs.tools.file import new_file

LOG_TOOL = "log_tool"  # metadata: which command made this file, from what


@dataclass(frozen=True, slots=True)
class Recovered:
    """The new file."""

    messages: int
    problem: str  # what of the old file could not be read; empty when it was whole


def recover(log: LogFile, out: Path, *, force: bool = False) -> Recovered:
    """Write a whole file with every message that can be read.

    Raises OSError: ``out`` exists, or cannot be written.
    """
    with new_file(out, force=force) as part:
        with part.open("wb") as stream:
            copier = _Copier(ChunkedWriter(stream, CHUNK_BYTES))
            for record in log.records():
                copier.take(record)
            problem = log.why_broken
            copier.end({"command": "recover", "source": log.path.name, "source_problem": problem})
        return Recovered(copier.messages, problem)


class _Copier:
    """Writes records of one file into another, with numbers of its own for schemas and channels."""

    def __init__(self, writer: ChunkedWriter) -> None:
        self._writer = writer
        self._headed = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, int] = {}
        self._written: dict[tuple[str, str, bytes], int] = {}  # schemas
        self.messages = 0

    def take(self, record: Any) -> None:
        """Write one record."""
        if not self._headed:
            header = record if isinstance(record, Header) else Header("", "")
            self._writer.start(header.profile, header.library)
            self._headed = True
        if isinstance(record, MessageRecord):
            self._writer.add_message(
                self._channels[record.channel_id], record.log_time, record.publish_time, record.sequence,
                record.data,
            )  # fmt: skip
            self.messages += 1
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
        """Write what was done, and the index."""
        if not self._headed:
            self._writer.start("", "")
        self._writer.add_metadata(LOG_TOOL, done)
        self._writer.finish()

    def _channel(self, channel: Channel) -> None:
        if channel.id in self._channels:
            return  # repeated in the summary
        schema = self._schemas.get(channel.schema_id)
        number = 0  # MCAP: a channel without a schema
        if schema is not None:
            key = (schema.name, schema.encoding, schema.data)
            if key not in self._written:
                self._written[key] = self._writer.register_schema(*key)
            number = self._written[key]
        self._channels[channel.id] = self._writer.register_channel(
            channel.topic, channel.message_encoding, number, channel.metadata
        )
