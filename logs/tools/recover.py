"""Makes a complete log from a damaged one.

Readable data are copied byte by byte: payloads, schemas, channel properties, metadata, attachments. Index and
statistics are made anew. A metadata record ``log_tool`` has the name of the command and the source.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.records import Message as MessageRecord

from logs.reader.reader import LogFile
from logs.recorder.mcap_file import CHUNK_BYTES, ChunkedWriter
from logs.tools.file import new_file

LOG_TOOL = "log_tool"  # metadata record with the command that made this file, and its source


@dataclass(frozen=True, slots=True)
class Recovered:
    """Summary of the new file."""

    messages: int
    problem: str  # unreadable part of the old file; empty if it was complete


def recover(log: LogFile, out: Path, *, force: bool = False) -> Recovered:
    """Write a complete file with every readable message.

    Raises OSError: ``out`` exists, or cannot be written.
    """
    with new_file(out, force=force) as part:
        with part.open("wb") as stream:
            writer, records = ChunkedWriter(stream, CHUNK_BYTES), log.records()
            first = next(records, None)
            header = first if isinstance(first, Header) else Header("", "")
            writer.start(header.profile, header.library)
            messages = _copy(writer, chain((first,), records))
            problem = log.why_broken
            done = {"command": "recover", "source": log.path.name, "source_problem": problem}
            writer.add_metadata(LOG_TOOL, done)
            writer.finish()
        return Recovered(messages, problem)


def _copy(writer: ChunkedWriter, records: Iterable[Any]) -> int:
    """Write records with new numbers of schemas and channels; return the number of messages."""
    declared: dict[int, Schema] = {}
    schemas, channels = {0: 0}, dict[int, int]()  # numbers in the new file; 0: a channel without a schema
    messages = 0
    for record in records:
        if isinstance(record, MessageRecord):
            writer.add_message(
                channels[record.channel_id], record.log_time, record.data, record.publish_time,
                record.sequence,
            )  # fmt: skip
            messages += 1
        elif isinstance(record, Schema):
            declared[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:  # the summary repeats channels
            number, schema = record.schema_id, declared.get(record.schema_id)
            if number not in schemas and schema is not None:
                schemas[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas.get(number, 0), record.metadata
            )
        elif isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
    return messages
