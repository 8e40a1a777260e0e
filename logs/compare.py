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
from hashlib import sha256
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

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
class Difference:
    """A value that differs between two logs, or between a log and its replay."""

    topic: str  # topic, or ``metadata NAME`` / ``attachment NAME``
    # position of the message in its topic, ordered by log time and sequence number, or number of the replayed
    # tick; -1: neither
    index: int
    field: str  # dotted name of the field, for example ``own_position_enu_m.x``
    a: str  # value in the first log, as text
    b: str  # value in the second log or in the replay, as text

    def __str__(self) -> str:
        where = f"{self.topic}[{self.index}]" if self.index >= 0 else self.topic
        return one_line(f"{where} {self.field}: {self.a} != {self.b}")


class Compared(NamedTuple):
    differences: list[Difference]  # first ``limit`` differences; empty: the logs are equal
    # number of the first controller step at or after the first different message; None: there is none
    first_tick: int | None


def compare(a: Path | str, b: Path | str, limit: int = MAX_DIFFERENCES) -> Compared:
    first, second = _content(a), _content(b)
    return Compared(list(islice(_all(first, second), limit)), _first_tick(first.messages, second.messages))


def _first_tick(a: dict[str, list[Message]], b: dict[str, list[Message]]) -> int | None:
    differ_ns = [
        min(message.log_time_ns for message in both if message is not None)
        for topic in a.keys() | b.keys()
        for both in zip_longest(a.get(topic, []), b.get(topic, []))
        if both[0] != both[1]
    ]
    from_ns = min(differ_ns, default=math.inf)
    later = [
        each
        for messages in (*a.values(), *b.values())
        for each in messages
        if each.schema == CONTROLLER_STEP and each.log_time_ns >= from_ns
    ]
    return min(later, key=lambda each: each.log_time_ns).sequence if later else None


class _Content(NamedTuple):
    records: dict[str, dict[str, str]]  # values of each metadata record, and summary of each attachment
    messages: dict[str, list[Message]]  # messages by topic, each ordered by log time and sequence number


def _content(path: Path | str) -> _Content:
    log, topics, steps = LogFile(path), dict[str, list[Message]](), 0
    for message in log.messages():
        steps += message.schema == CONTROLLER_STEP
        event = LogRow.unpack(message.data).name if message.schema == LOG else ""
        if message.schema not in WALL_CLOCK_SCHEMAS and event not in WALL_CLOCK_EVENTS:
            topics.setdefault(message.topic, []).append(message)
    if not log.complete:
        raise LogError(
            f"{log.path} is not a whole log ({log.problem}); only logs closed by the recorder compare"
        )
    if not steps:
        raise LogError(f"{log.path} holds no controller step, so there is nothing to compare")
    for messages in topics.values():
        messages.sort(key=lambda m: (m.log_time_ns, m.sequence, m.publish_time_ns, m.data))
    records = {
        f"metadata {name}": {k: v for k, v in values.items() if k not in WALL_CLOCK_METADATA_KEYS}
        for name, values in log.metadata().items()
        if split(name)[1] not in WALL_CLOCK_METADATA
    }
    for each in log.attachments():
        content = f"{each.media_type}, {len(each.data)} bytes, sha256 {sha256(each.data).hexdigest()[:16]}"
        records[f"attachment {each.name}"] = {"content": content}
    return _Content(records, topics)


def _all(a: _Content, b: _Content) -> Iterator[Difference]:
    for name in sorted(a.records.keys() | b.records.keys()):
        for each in values_of(a.records.get(name, {}), b.records.get(name, {})):
            yield Difference(name, -1, *each)
    for topic in sorted(a.messages.keys() | b.messages.keys()):
        first, second = a.messages.get(topic, []), b.messages.get(topic, [])
        if len(first) != len(second):
            yield Difference(topic, -1, "count", str(len(first)), str(len(second)))
        for index, (x, y) in enumerate(zip(first, second, strict=False)):
            if x == y:
                continue
            same = x.schema == y.schema
            data = messages_of(x.schema, x.data, y.data) if same else values_of(x.data, y.data, "data")
            for each in (*values_of(x._replace(data=b""), y._replace(data=b"")), *data):
                yield Difference(topic, index, *each)


def messages_of(schema: str, a: bytes, b: bytes) -> Iterator[tuple[str, str, str]]:
    """Yield (field, a, b) for each different field of two CDR messages, or the bytes if undecodable."""
    if a == b:
        return
    found: list[tuple[str, str, str]] = []
    with suppress(Exception):  # a library may raise any exception for damaged bytes
        store = store_for(schema)
        found = list(values_of(store.deserialize_cdr(a, schema), store.deserialize_cdr(b, schema)))
    yield from found or [("data", a.hex(), b.hex())]


def values_of(a: Any, b: Any, name: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield (field, a, b) of each difference in bits: NaNs with equal bits are equal, 0.0 and -0.0 differ."""
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


SHOWN_MAX = 10  # maximum number of stored differences; further differences are only counted


@dataclass
class Tally:
    """Differences of one kind that a replay found: their number, and the first ``SHOWN_MAX`` of them."""

    count: int = 0
    ticks: int = 0  # number of ticks with a difference
    first: list[Difference] = dataclasses.field(default_factory=list)

    def __post_init__(self) -> None:
        self._newest = -1  # number of the newest tick with a difference

    def add(self, topic: str, tick: int, found: Iterable[tuple[str, str, str]]) -> None:
        """Add the differences (field, recorded, replayed) of a topic in a tick."""
        for each in found:
            self.count += 1
            self.ticks += tick != self._newest
            self._newest = tick
            if len(self.first) < SHOWN_MAX:
                self.first.append(Difference(topic, tick, *each))
