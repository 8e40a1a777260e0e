"""Exports a topic of a log for other programs, as CSV or Parquet (extra ``export``).

A table has one column per number, named as in the message definition: ``own_position_enu_m.x`` is a nested
field, ``rotor_rpm[2]`` an element of an array of fixed length. A list of variable length is one column of
JSON text, so that the columns never depend on the data. The columns come from the definitions inside the log,
so logs of other programs and of older versions can be read, too.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from logs.reader.reader import LogFile
from logs.tools.file import new_file

JSON_TEXT = "json"  # kind of a column that holds a list
HEAD = (("log_time_ns", "uint64"), ("publish_time_ns", "uint64"), ("sequence", "uint32"))
ROWS_AT_ONCE = 10_000  # rows written together: memory is bounded for flights of any length
_NOT_ARROW = {JSON_TEXT: "string", "float32": "float32", "float64": "float64", "bool": "bool_",
              "byte": "uint8", "char": "uint8", "octet": "uint8", "wstring": "string"}  # fmt: skip

_Description = Any  # rosbags: (Nodetype, arguments)


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the exported table."""

    name: str  # dotted name of the field
    kind: str  # ROS primitive type, for example ``float64``; or ``JSON_TEXT``
    path: tuple[str | int, ...]  # attribute names and indices from the message to the value

    def value(self, message: Any) -> Any:
        for step in self.path:
            message = message[step] if isinstance(step, int) else getattr(message, step)
        if self.kind == JSON_TEXT:
            return json.dumps(_plain(message))
        return message.item() if isinstance(message, np.generic) else message


class Table:
    """One topic of a log as rows."""

    def __init__(self, log: LogFile, topic: str) -> None:
        """Find the topic and its type."""
        self._log, self._topic = log, topic
        schema = _schema_of(log, topic)
        self._type = schema.name
        self._store = get_typestore(Stores.EMPTY)
        try:
            self._store.register(get_types_from_msg(schema.data.decode(), schema.name))
            # columns after those of ``HEAD``
            self.columns = list(_columns(self._store, (Nodetype.NAME, schema.name), "", ()))
        except Exception as error:  # a library may raise any exception for a damaged definition
            what = f"{log.path}: the definition of {schema.name} cannot be read"
            raise ValueError(f"{what} ({type(error).__name__}: {error})") from error

    def rows(self) -> Iterator[list[Any]]:
        """Yield one row per message that can be decoded, in the order of the file."""
        for message in self._log.messages([self._topic]):
            try:
                decoded = self._store.deserialize_cdr(message.data, self._type)
                values = [column.value(decoded) for column in self.columns]
            except Exception as error:  # or for a damaged message
                self._log.refuse(message, error)
                continue
            yield [message.log_time_ns, message.publish_time_ns, message.sequence, *values]


def _schema_of(log: LogFile, topic: str) -> Schema:
    schemas: dict[int, Schema] = {}
    channels: dict[str, dict[int, Channel]] = {}
    for record in log.records():
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels.setdefault(record.topic, {})[record.id] = record
    found = channels.get(topic, {})
    if not found:
        known = ", ".join(sorted(channels)) or "none"
        raise ValueError(f"no topic {topic!r} in {log.path}; it holds {known}")
    types = {schemas[c.schema_id].name for c in found.values() if c.schema_id in schemas}
    ways = {(c.message_encoding, getattr(schemas.get(c.schema_id), "encoding", "")) for c in found.values()}
    if len(types) != 1 or ways != {("cdr", "ros2msg")}:
        raise ValueError(
            f"{topic} holds {', '.join(sorted(types)) or 'no known type'}, encoded as "
            f"{', '.join(sorted('/'.join(w) for w in ways))}; one type in cdr/ros2msg can be exported"
        )
    return schemas[next(iter(found.values())).schema_id]


def _columns(
    store: Typestore, description: _Description, name: str, path: tuple[str | int, ...]
) -> Iterator[Column]:
    kind, arguments = description
    if kind == Nodetype.BASE:
        yield Column(name, str(arguments[0]), path)
    elif kind == Nodetype.NAME:
        for field, inner in store.fielddefs[arguments][1]:
            yield from _columns(store, inner, f"{name}.{field}" if name else field, (*path, field))
    elif kind == Nodetype.ARRAY:
        inner, length = arguments
        for i in range(length):
            yield from _columns(store, inner, f"{name}[{i}]", (*path, i))
    else:
        yield Column(name, JSON_TEXT, path)


def _plain(value: Any) -> Any:
    """Convert a decoded value into JSON types; NaN and infinity become text."""
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is not None:
        return {f: _plain(getattr(value, f)) for f in fields if f != "__msgtype__"}
    return value


class MissingExtraError(ValueError):
    """An optional package is missing."""


def export_csv(log: LogFile, topic: str, out: Path, *, force: bool = False) -> int:
    """Write a topic as CSV with a header line; return the number of rows. Floats are written exactly."""
    table, rows = Table(log, topic), 0
    with new_file(out, force=force) as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([name for name, _ in HEAD] + [column.name for column in table.columns])
        for row in table.rows():
            writer.writerow(row)
            rows += 1
    return rows


def export_parquet(log: LogFile, topic: str, out: Path, *, force: bool = False) -> int:
    """Write a topic as Parquet with typed columns; return the number of rows."""
    arrow, parquet = _pyarrow()
    table, rows = Table(log, topic), 0
    fields = [*HEAD, *((column.name, column.kind) for column in table.columns)]
    schema = arrow.schema([(name, getattr(arrow, _NOT_ARROW.get(kind, kind))()) for name, kind in fields])
    with new_file(out, force=force) as part, parquet.ParquetWriter(part, schema) as writer:
        for batch in _batches(table.rows()):
            arrays = [
                arrow.array(values, field.type)
                for values, field in zip(zip(*batch, strict=True), schema, strict=True)
            ]
            writer.write_table(arrow.Table.from_arrays(arrays, schema=schema))
            rows += len(batch)
    return rows


def _batches(rows: Iterator[list[Any]]) -> Iterator[list[list[Any]]]:
    while batch := list(islice(rows, ROWS_AT_ONCE)):
        yield batch


def _pyarrow() -> tuple[ModuleType, ModuleType]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise MissingExtraError(
            "Parquet needs pyarrow, which is not installed; `pip install 'crazyflie-flightstack[export]'`, "
            "or use --format csv"
        ) from error
    return pyarrow, pyarrow.parquet
