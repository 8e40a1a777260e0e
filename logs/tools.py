"""Summarises a log, repairs a damaged log, and writes one topic of a log as a table.

All three functions also read logs of other programs, with the message definitions in the file, and use the
readable part of a damaged log.
"""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import Writer

from flightstack.common.strict_toml import meant
from flightstack.common.text import one_line
from logs.reader.mcap_records import Records
from logs.reader.reader import LogFile

_NS = 1e9  # nanoseconds per second
TOPICS_SHOWN = 10  # maximum number of topics in an error message


def summary(log: LogFile) -> dict[str, Any]:
    """Return the object that ``log info --json`` prints; ``problem`` is empty for a complete log."""
    # by (topic, schema): number of messages, first and last log time, ns
    found: dict[tuple[str, str], tuple[int, int, int]] = {}
    for message in log.messages():
        key, now_ns = (message.topic, message.schema), message.log_time_ns
        number, first_ns, last_ns = found.get(key, (0, now_ns, now_ns))
        found[key] = number + 1, min(first_ns, now_ns), max(last_ns, now_ns)
    start_ns = min((first_ns for _, first_ns, _ in found.values()), default=0)
    end_ns = max((last_ns for *_, last_ns in found.values()), default=0)
    return {
        "path": str(log.path),
        "size_bytes": log.path.stat().st_size,
        "complete": log.complete,
        "problem": log.problem,
        "library": log.outline.library,
        "start": datetime.fromtimestamp(start_ns // 10**9, UTC).isoformat(),
        "duration_s": (end_ns - start_ns) / _NS,
        "messages": sum(number for number, *_ in found.values()),
        "topics": [
            {
                "topic": topic,
                "schema": schema,
                "messages": number,
                "rate_hz": (number - 1) * _NS / (last_ns - first_ns) if last_ns > first_ns else None,
            }
            for (topic, schema), (number, first_ns, last_ns) in sorted(found.items())
        ],
        "metadata": log.metadata(),
        "attachments": [{"name": each.name, "bytes": len(each.data)} for each in log.attachments()],
    }


def summary_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"{one_line(found['path'])}: {found['size_bytes']} bytes, written by {one_line(found['library'])}",
        f"{found['messages']} messages in {found['duration_s']:.3f} s of log time from {found['start']}",
        "complete" if found["complete"] else f"BROKEN: {one_line(found['problem'])}",
        "",
        f"{'topic':32} {'schema':40} {'messages':>9} {'rate':>9}",
    ]
    for each in found["topics"]:
        rate = "" if each["rate_hz"] is None else f"{each['rate_hz']:.1f} Hz"
        topic, schema = one_line(each["topic"]), one_line(each["schema"])
        lines.append(f"{topic:32} {schema:40} {each['messages']:9} {rate:>9}")
    for name, values in found["metadata"].items():
        lines += ["", f"metadata {one_line(name)}"]
        lines += [f"  {one_line(key)} = {one_line(value)}" for key, value in values.items()]
    lines += ["", "attachments"] if found["attachments"] else []
    return lines + [f"  {one_line(each['name'])}  {each['bytes']} bytes" for each in found["attachments"]]


def recover(log: LogFile, out: Path) -> int:
    """Write a complete file with an index and all readable records; return the number of messages."""
    schemas, channels = {0: 0}, dict[int, int]()  # ids in the new file by ids in the log; 0: no schema
    messages = 0
    with log.path.open("rb") as source, out.open("wb") as stream:
        records = iter(Records(source, messages=True))
        first = next(records, None)
        header = first if isinstance(first, Header) else Header("", "")
        writer = Writer(stream)
        writer.start(header.profile, header.library)
        for record in chain((first,), records):
            if isinstance(record, Message):
                writer.add_message(
                    channels[record.channel_id], record.log_time, record.data, record.publish_time,
                    record.sequence,
                )  # fmt: skip
                messages += 1
            elif isinstance(record, Schema) and record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel) and record.id not in channels:  # the summary repeats channels
                schema = schemas.get(record.schema_id, 0)
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schema, record.metadata
                )
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                writer.add_attachment(
                    record.create_time, record.log_time, record.name, record.media_type, record.data
                )
        writer.finish()
    return messages


def rows(log: LogFile, topic: str, refused: Counter[str]) -> Iterator[dict[str, Any]]:
    """Yield a row for each message of a topic; nested fields have dotted names, a list is one JSON text.

    Reasons why messages cannot be decoded are counted in ``refused``. Raises ValueError: the log has no such
    topic, or the topic is not CDR.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store, kind = get_typestore(Stores.EMPTY), _schema(log, topic)
    try:
        store.register(get_types_from_msg(kind.data.decode(), kind.name))
    except Exception as error:  # a library may raise any exception for a damaged definition
        what = f"{log.path}: the definition of {kind.name} cannot be read"
        raise ValueError(f"{what} ({type(error).__name__}: {error})") from error
    for message in log.messages([topic]):
        times = {"log_time_ns": message.log_time_ns, "publish_time_ns": message.publish_time_ns}
        try:
            decoded = dict(_flat("", store.deserialize_cdr(message.data, kind.name)))
        except Exception as error:  # a library may raise any exception for a damaged message
            refused[f"{type(error).__name__}: {error}"] += 1
        else:
            yield times | {"sequence": message.sequence} | decoded


def _schema(log: LogFile, topic: str) -> Schema:
    found = [each for each in log.outline.channels.values() if each.topic == topic]
    if not found:
        topics = sorted({each.topic for each in log.outline.channels.values()})
        close = meant(topic, topics)
        more = f" and {len(topics) - TOPICS_SHOWN} more (`log info`)" if topics[TOPICS_SHOWN:] else ""
        raise ValueError(
            f"no topic {topic!r} in {log.path}; {close and f'{close} '}"
            f"it contains {', '.join(topics[:TOPICS_SHOWN]) or 'none'}{more}"
        )
    used = {kind.name: kind for each in found if (kind := log.outline.schemas.get(each.schema_id))}
    encodings = {each.message_encoding for each in found}
    if len(used) != 1 or encodings != {"cdr"} or next(iter(used.values())).encoding != "ros2msg":
        raise ValueError(
            f"{topic} has the types {', '.join(sorted(used)) or 'none'} in the encodings "
            f"{', '.join(sorted(encodings))}; one type in CDR with a ros2msg definition can be exported"
        )
    return next(iter(used.values()))


def export_csv(table: Iterator[dict[str, Any]], out: Path) -> int:
    """Write rows as CSV with a header line; return their number. Floats are written without rounding."""
    number = 0
    with out.open("w", newline="", encoding="utf-8") as stream:
        for number, row in enumerate(table, 1):
            if number == 1:
                writer = csv.DictWriter(stream, list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow(row)
    return number


def export_parquet(table: Iterator[dict[str, Any]], out: Path) -> int:
    """Write rows as Parquet, all at once; return their number."""
    import pyarrow
    from pyarrow import parquet

    whole = pyarrow.Table.from_pylist(list(table))
    parquet.write_table(whole, out)
    return len(whole)


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and value of each column of a decoded message."""
    if is_dataclass(value):
        for part in fields(value):
            if part.name != "__msgtype__":
                yield from _flat(f"{name}.{part.name}" if name else part.name, getattr(value, part.name))
    elif isinstance(value, np.ndarray | list | tuple):
        yield name, json.dumps([_json(each) for each in value])
    else:
        yield name, value.item() if isinstance(value, np.generic) else value


def _json(value: Any) -> Any:
    """Convert an element of a list to JSON types; NaN and infinity become text."""
    if is_dataclass(value):
        return dict(_flat("", value))
    value = value.item() if isinstance(value, np.generic) else value
    return str(value) if isinstance(value, float) and not np.isfinite(value) else value
