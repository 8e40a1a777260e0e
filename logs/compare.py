"""Compares two flight logs, or a log and its replay, value by value, with declared exceptions.

Two runs of one seed in lockstep must give equal logs. Data that depend on the wall clock are listed in the
tables below, and nowhere else. Messages of different processes reach the recorder in any order, so each topic
is compared separately, ordered by log time and sequence number.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.common.text import one_line
from logs.reader.reader import LogError, LogFile, Message
from logs.recorder.recording import RECORDER, RECORDER_NAME
from logs.schema import LOSSES, split
from logs.schema.mavlink import MAVLINK_PEERS
from logs.schema.rows import LogRow
from logs.schema.schemas import CONTROLLER_STEP, LOG, LOOP_TIMING, store_for

WALL_CLOCK_SCHEMAS = frozenset({LOOP_TIMING})
WALL_CLOCK_EVENTS = frozenset({RECORDER_NAME})  # sources of /rosout events that depend on the wall clock
WALL_CLOCK_METADATA = frozenset({LOSSES, RECORDER, MAVLINK_PEERS})  # metadata with wall times or ports
WALL_CLOCK_METADATA_KEYS = frozenset(
    {"started", "started_unix_s", "ended", "wall_time_s", "realtime_factor", "host", "out", "log", "pid"}
)
MAX_DIFFERENCES = 100  # maximum number of reported differences

ABSENT = "absent"
_F64 = struct.Struct("<d")


@dataclass(frozen=True, slots=True)
class MessageDifference:
    """A field of a message, metadata record or attachment in which two logs differ."""

    topic: str  # topic, or ``metadata NAME`` / ``attachment NAME``
    index: int  # number of the message in its topic, by log time and sequence; -1 without one
    field: str  # dotted name of the field, for example ``own_position_enu_m.x``
    a: str  # value in the first log
    b: str  # value in the second log

    def __str__(self) -> str:
        where = f"{self.topic}[{self.index}]" if self.index >= 0 else self.topic
        return one_line(f"{where} {self.field}: {self.a} != {self.b}")


def compare(a: Path | str, b: Path | str, limit: int = MAX_DIFFERENCES) -> list[MessageDifference]:
    """Return the differences between two logs, at most ``limit``; empty means equal."""
    first, second = LogFile(a), LogFile(b)
    topics_a, topics_b = _by_topic(first), _by_topic(second)
    found: list[MessageDifference] = []
    for difference in _all(first, second, topics_a, topics_b):
        found.append(difference)
        if len(found) >= limit:
            break
    return found


def first_tick(a: Path | str, b: Path | str) -> int | None:
    """Return the number of the first tick with a difference in a message; None: no message differs."""
    first, second = _by_topic(LogFile(a)), _by_topic(LogFile(b))
    differ_ns = [
        min(message.log_time_ns for message in both if message is not None)
        for topic in first.keys() | second.keys()
        for both in zip_longest(first.get(topic, []), second.get(topic, []))
        if both[0] != both[1]
    ]
    steps = [each for log in (first, second) for messages in log.values() for each in messages]
    from_ns = min(differ_ns, default=math.inf)
    later = [each for each in steps if each.schema == CONTROLLER_STEP and each.log_time_ns >= from_ns]
    return min(later, key=lambda each: each.log_time_ns).sequence if later else None


def _all(
    first: LogFile, second: LogFile, a: dict[str, list[Message]], b: dict[str, list[Message]]
) -> Iterator[MessageDifference]:
    yield from _metadata(first.metadata(), second.metadata())
    yield from _attachments(first, second)
    for topic in sorted(a.keys() | b.keys()):
        yield from _topic(topic, a.get(topic, []), b.get(topic, []))


def _by_topic(log: LogFile) -> dict[str, list[Message]]:
    topics: dict[str, list[Message]] = {}
    steps = 0
    for message in log.messages():
        steps += message.schema == CONTROLLER_STEP
        if not _wall_clock(message):
            topics.setdefault(message.topic, []).append(message)
    if not log.complete:
        raise LogError(
            f"{log.path} is not a whole log ({log.problem}); only logs closed by the recorder compare"
        )
    if not steps:
        raise LogError(f"{log.path} holds no controller step, so there is nothing to compare")
    for messages in topics.values():
        messages.sort(key=lambda m: (m.log_time_ns, m.sequence, m.publish_time_ns, m.data))
    return topics


def _wall_clock(message: Message) -> bool:
    if message.schema in WALL_CLOCK_SCHEMAS:
        return True
    return message.schema == LOG and LogRow.unpack(message.data).name in WALL_CLOCK_EVENTS


def _topic(topic: str, a: list[Message], b: list[Message]) -> Iterator[MessageDifference]:
    if len(a) != len(b):
        yield MessageDifference(topic, -1, "count", str(len(a)), str(len(b)))
    for index, (x, y) in enumerate(zip(a, b, strict=False)):
        if x == y:
            continue
        for field in ("schema", "log_time_ns", "publish_time_ns", "sequence"):
            if getattr(x, field) != getattr(y, field):
                yield MessageDifference(topic, index, field, str(getattr(x, field)), str(getattr(y, field)))
        if x.data != y.data:
            yield from _data(topic, index, x, y)


def _data(topic: str, index: int, x: Message, y: Message) -> Iterator[MessageDifference]:
    if x.schema == y.schema:
        found = messages_of(x.schema, x.data, y.data)
    else:
        found = iter([("data", x.data.hex(), y.data.hex())])
    for field, a, b in found:
        yield MessageDifference(topic, index, field, a, b)


def messages_of(schema: str, a: bytes, b: bytes) -> Iterator[tuple[str, str, str]]:
    """Yield (field, a, b) for each different field of two CDR messages; the bytes if all fields are equal."""
    if a == b:
        return
    found: list[tuple[str, str, str]] = []
    with suppress(Exception):  # a library may raise any exception for damaged bytes
        store = store_for(schema)
        found = list(values_of(store.deserialize_cdr(a, schema), store.deserialize_cdr(b, schema)))
    yield from found or [("data", a.hex(), b.hex())]


def values_of(a: Any, b: Any, name: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield (field, a, b) of each difference, bit by bit: NaNs of equal bits are equal, 0.0 and -0.0 not."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        a, b = a.tolist(), b.tolist()
    if type(a) is not type(b):
        yield name, _text(a), _text(b)
    elif dataclasses.is_dataclass(a) and not isinstance(a, type):
        for each in dataclasses.fields(a):
            inner = f"{name}.{each.name}" if name else each.name
            yield from values_of(getattr(a, each.name), getattr(b, each.name), inner)
    elif isinstance(a, dict):
        for key in a | b:
            yield from values_of(a.get(key, ABSENT), b.get(key, ABSENT), f"{name}.{key}" if name else key)
    elif isinstance(a, tuple | list):
        if len(a) != len(b):
            yield f"{name}.length", str(len(a)), str(len(b))
        names = getattr(a, "_fields", None)
        for n, (x, y) in enumerate(zip(a, b, strict=False)):
            inner = f"{name}[{n}]" if not names else f"{name}.{names[n]}" if name else names[n]
            yield from values_of(x, y, inner)
    elif isinstance(a, float):
        raw_a, raw_b = _F64.pack(a), _F64.pack(b)
        if raw_a != raw_b:
            if str(a) != str(b):
                yield name, str(a), str(b)
            else:
                yield name, f"{a} (bytes {raw_a.hex()})", f"{b} (bytes {raw_b.hex()})"
    elif a != b:
        yield name, _text(a), _text(b)


def _text(value: Any) -> str:
    return value.name if isinstance(value, Enum) else repr(value)


def _metadata(a: dict[str, dict[str, str]], b: dict[str, dict[str, str]]) -> Iterator[MessageDifference]:
    for name in sorted(a.keys() | b.keys()):
        if split(name)[1] in WALL_CLOCK_METADATA:
            continue
        values_a, values_b = a.get(name, {}), b.get(name, {})
        for key in sorted((values_a.keys() | values_b.keys()) - WALL_CLOCK_METADATA_KEYS):
            x, y = values_a.get(key, ABSENT), values_b.get(key, ABSENT)
            if x != y:
                yield MessageDifference(f"metadata {name}", -1, key, x, y)


def _attachments(first: LogFile, second: LogFile) -> Iterator[MessageDifference]:
    a, b = ({x.name: x for x in log.attachments()} for log in (first, second))
    for name in sorted(a.keys() | b.keys()):
        x, y = a.get(name), b.get(name)
        if x is None or y is None:
            present = (ABSENT if x is None else "present", ABSENT if y is None else "present")
            yield MessageDifference(f"attachment {name}", -1, "presence", *present)
        elif (x.media_type, x.data) != (y.media_type, y.data):
            sizes = (f"{x.media_type} {len(x.data)} bytes", f"{y.media_type} {len(y.data)} bytes")
            yield MessageDifference(f"attachment {name}", -1, "content", *sizes)


SHOWN_MAX = 10  # maximum number of stored differences; further differences are only counted


@dataclass(frozen=True, slots=True)
class TickDifference:
    """A value that differs between log and replay."""

    topic: str  # topic of the recorded value
    tick: int  # number of the controller tick
    field: str  # dotted name as in the message definition
    recorded: str  # value in the log, as text
    replayed: str  # value of this replay, as text

    def __str__(self) -> str:
        return (
            f"{self.topic} tick {self.tick} {self.field}: recorded {self.recorded}, replayed {self.replayed}"
        )


@dataclass
class Tally:
    """Differences of one kind: their number, and the first ones."""

    count: int = 0
    ticks: int = 0  # number of ticks with a difference
    first: list[TickDifference] = dataclasses.field(default_factory=list)

    def add(self, found: Iterable[TickDifference]) -> None:
        before = self.count
        for each in found:
            self.count += 1
            if len(self.first) < SHOWN_MAX:
                self.first.append(each)
        self.ticks += self.count > before
