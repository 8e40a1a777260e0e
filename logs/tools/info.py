"""Summarises the content of a log in one pass, with bounded memory."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from mcap.records import Channel, Header, Schema
from mcap.records import Message as MessageRecord

from flightstack.common.text import one_line
from logs.reader.reader import LogFile

_NS = 1e9  # nanoseconds per second


@dataclass
class Topic:
    topic: str
    schema: str
    encoding: str
    messages: int = 0
    first_ns: int = 0  # log time of the first message, ns
    last_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Mean rate between the first and the last message; None: fewer than two, or no time between them."""
        span_s = (self.last_ns - self.first_ns) / _NS
        return (self.messages - 1) / span_s if span_s > 0.0 else None


def gather(log: LogFile) -> dict[str, Any]:
    """Return the object that ``log info --json`` prints; times in seconds and as text.

    ``problem``: unreadable part, empty for a complete log; ``readable_bytes``: from the start to the first
    damage, the size of a complete file; ``start_ns``, ``end_ns``: log times of the messages, Unix.
    """
    schemas: dict[int, str] = {}
    channels: dict[int, Topic] = {}
    topics: dict[tuple[str, str], Topic] = {}
    profile = library = ""
    for record in log.records():
        if isinstance(record, MessageRecord):
            topic, now_ns = channels[record.channel_id], record.log_time
            topic.first_ns = min(topic.first_ns, now_ns) if topic.messages else now_ns
            topic.last_ns = max(topic.last_ns, now_ns)
            topic.messages += 1
        elif isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id, "")
            new = Topic(record.topic, schema, record.message_encoding)
            channels[record.id] = topics.setdefault((record.topic, schema), new)
        elif isinstance(record, Header):
            profile, library = record.profile, record.library
    problem, readable_bytes = log.problem, log.broken_at
    known = [topic for topic in topics.values() if topic.messages]
    start_ns = min((topic.first_ns for topic in known), default=0)
    end_ns = max((topic.last_ns for topic in known), default=0)
    return {
        "path": str(log.path),
        "size_bytes": log.path.stat().st_size,
        "complete": log.complete,
        "problem": problem,
        "readable_bytes": readable_bytes,
        "profile": profile,
        "library": library,
        "start_ns": start_ns,
        "end_ns": end_ns,
        "messages": sum(topic.messages for topic in known),
        "topics": [
            {"topic": t.topic, "schema": t.schema, "encoding": t.encoding, "messages": t.messages,
             "rate_hz": t.rate_hz}
            for t in sorted(topics.values(), key=lambda t: t.topic)
        ],
        "metadata": log.metadata(),
        "attachments": [
            {"name": a.name, "media_type": a.media_type, "bytes": len(a.data)} for a in log.attachments()
        ],
        "start": _utc(start_ns),
        "end": _utc(end_ns),
        "duration_s": (end_ns - start_ns) / _NS,
    }  # fmt: skip


def lines(info: dict[str, Any]) -> list[str]:
    last = f"last message {info['duration_s']:.3f} s after the first"
    found = [
        f"{one_line(info['path'])}: {info['size_bytes']} bytes, profile {info['profile']!r}, by "
        f"{info['library']!r}",
        f"{info['messages']} messages in {info['duration_s']:.3f} s, {info['start']} to {info['end']} "
        "(log time)",
        "complete" if info["complete"] else f"BROKEN: {info['problem']}; {last}",
        "",
        f"{'topic':32} {'schema':40} {'messages':>9} {'rate':>9}",
    ]
    for t in info["topics"]:
        rate = "" if t["rate_hz"] is None else f"{t['rate_hz']:.1f} Hz"
        found.append(f"{one_line(t['topic']):32} {one_line(t['schema']):40} {t['messages']:9} {rate:>9}")
    for name, values in info["metadata"].items():
        found += ["", f"metadata {one_line(name)}"]
        found += [f"  {one_line(key)} = {one_line(value)}" for key, value in values.items()]
    if info["attachments"]:
        found += ["", "attachments"]
        for each in info["attachments"]:
            found.append(one_line(f"  {each['name']}  {each['media_type']}  {each['bytes']} bytes"))
    return found


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
