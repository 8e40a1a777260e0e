"""Summarises the content of a log in one pass, with bounded memory."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
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


@dataclass
class Info:
    path: str
    size_bytes: int
    complete: bool
    problem: str  # unreadable part; empty for a complete log
    readable_bytes: int  # bytes from the start to the first damage; the size of a complete file
    profile: str = ""
    library: str = ""
    start_ns: int = 0  # log time of the first message, Unix
    end_ns: int = 0
    messages: int = 0
    topics: list[Topic] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[dict[str, Any]] = field(default_factory=list)

    @property
    def duration_s(self) -> float:
        """Log time from the first message to the last."""
        return (self.end_ns - self.start_ns) / _NS

    def as_json(self) -> dict[str, Any]:
        """Return the content as plain values; times in seconds and as text."""
        topics = [
            {"topic": t.topic, "schema": t.schema, "encoding": t.encoding, "messages": t.messages,
             "rate_hz": t.rate_hz}
            for t in self.topics
        ]  # fmt: skip
        times = {"start": _utc(self.start_ns), "end": _utc(self.end_ns), "duration_s": self.duration_s}
        return asdict(self) | times | {"topics": topics}


def gather(log: LogFile) -> Info:
    schemas: dict[int, str] = {}
    channels: dict[int, Topic] = {}
    topics: dict[tuple[str, str], Topic] = {}
    info = Info(str(log.path), log.path.stat().st_size, False, "", 0)
    started = False
    for record in log.records():
        if isinstance(record, MessageRecord):
            topic, now_ns = channels[record.channel_id], record.log_time
            topic.first_ns = min(topic.first_ns, now_ns) if topic.messages else now_ns
            topic.last_ns = max(topic.last_ns, now_ns)
            topic.messages += 1
            info.start_ns = min(info.start_ns, now_ns) if started else now_ns
            info.end_ns = max(info.end_ns, now_ns)
            started = True
        elif isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id, "")
            new = Topic(record.topic, schema, record.message_encoding)
            channels[record.id] = topics.setdefault((record.topic, schema), new)
        elif isinstance(record, Header):
            info.profile, info.library = record.profile, record.library
    info.problem, info.readable_bytes = log.problem, log.broken_at
    info.complete = log.complete
    info.topics = sorted(topics.values(), key=lambda t: t.topic)
    info.messages = sum(t.messages for t in info.topics)
    info.metadata = log.metadata()
    info.attachments = [
        {"name": a.name, "media_type": a.media_type, "bytes": len(a.data)} for a in log.attachments()
    ]
    return info


def lines(info: Info) -> list[str]:
    found = [
        f"{one_line(info.path)}: {info.size_bytes} bytes, profile {info.profile!r}, by {info.library!r}",
        f"{info.messages} messages in {info.duration_s:.3f} s, "
        f"{_utc(info.start_ns)} to {_utc(info.end_ns)} (log time)",
        "complete" if info.complete else f"BROKEN: {broken(info)}",
        "",
        f"{'topic':32} {'schema':40} {'messages':>9} {'rate':>9}",
    ]
    for topic in info.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f} Hz"
        found.append(f"{one_line(topic.topic):32} {one_line(topic.schema):40} {topic.messages:9} {rate:>9}")
    for name, values in info.metadata.items():
        found += ["", f"metadata {one_line(name)}"]
        found += [f"  {one_line(key)} = {one_line(value)}" for key, value in values.items()]
    if info.attachments:
        found += ["", "attachments"]
        for each in info.attachments:
            found.append(one_line(f"  {each['name']}  {each['media_type']}  {each['bytes']} bytes"))
    return found


def broken(info: Info) -> str:
    """Return a text about the place where a log is broken."""
    return f"{info.problem}; last message {info.duration_s:.3f} s after the first"


def _utc(time_ns: int) -> str:
    return datetime.fromtimestamp(time_ns // 10**9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
