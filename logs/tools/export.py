"""One topic of a log as a table for other programs: CSV, or Parquet with the extra ``export``."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

from logs.reader.reader import LogFile
from logs.tools.file import new_file
from logs.tools.flatten import HEAD, JSON_TEXT, Table

ROWS_AT_ONCE = 10_000  # of Parquet: bounded memory, whatever the length of the flight
_NOT_ARROW = {JSON_TEXT: "string", "float32": "float32", "float64": "float64", "bool": "bool_",
              "byte": "uint8", "char": "uint8", "octet": "uint8", "wstring": "string"}  # fmt: skip


class MissingExtraError(ValueError):
    """An optional package is needed; says which, and how to get it."""


def export_csv(log: LogFile, topic: str, out: Path, *, force: bool = False) -> int:
    """Write a topic as CSV with a head line; return the number of rows. Floats are exact (shortest form).

    Raises:
        ValueError: No such topic, or one that cannot be decoded.
        OSError: ``out`` exists, or cannot be written.
    """
    table, rows = Table(log, topic), 0
    with new_file(out, force=force) as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([name for name, _ in HEAD] + [column.name for column in table.columns])
        for row in table.rows():
            writer.writerow(row)
            rows += 1
    return rows


def export_parquet(log: LogFile, topic: str, out: Path, *, force: bool = False) -> int:
    """Write a topic as Parquet with typed columns; return the number of rows.

    Raises:
        MissingExtraError: pyarrow is not installed.
        ValueError: No such topic, or one that cannot be decoded.
        OSError: ``out`` exists, or cannot be written.
    """
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
            "or take --format csv"
        ) from error
    return pyarrow, pyarrow.parquet
