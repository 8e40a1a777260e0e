"""Generates ``logs/schema/rows.pyi``, types for mypy: ``python -m tests.unit.logs.row_stubs``."""

from __future__ import annotations

from pathlib import Path

from bridge.ros2.codec import CODES, HEADER_TYPE, TIME_TYPES
from logs.schema import rows
from logs.schema.rows import COLUMNS, ROWS, class_name, column_fields, value_name
from logs.schema.schemas import Field, fields_of

STUB = Path(rows.__file__).with_suffix(".pyi")
_HEAD = """\
# Made from the message definitions by `python -m tests.unit.logs.row_stubs`; changes belong there.
# fmt: off
# ruff: noqa
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.ros2.codec import Field

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ROWS: tuple[str, ...]
COLUMNS: tuple[str, ...]

def class_name(schema: str, end: str) -> str: ...
def value_name(field: Field) -> str: ...
def column_type(field: Field) -> str: ...
def column_fields(schema: str) -> list[tuple[str, str]]: ...
"""
_PYTHON = {"?": "bool", "d": "float", "f": "float"}


def text() -> str:
    """Return the text of ``rows.pyi``, generated from the message definitions."""
    lines = [_HEAD]
    for schema in ROWS:
        name = class_name(schema, "Row")
        lines.append(f"class {name}(NamedTuple):")
        lines += [f"    {value_name(field)}: {_type(field)}" for field in fields_of(schema)]
        lines += ["    def pack(self) -> bytes: ...", "    @staticmethod"]
        lines += [f"    def unpack(data: bytes) -> {name}: ...", ""]
    for schema in COLUMNS:
        lines += ["@dataclass(frozen=True)", f"class {class_name(schema, 'Columns')}:"]
        lines += [*(f"    {field}: {kind}" for field, kind in column_fields(schema)), ""]
    return "\n".join(lines)


def _type(field: Field) -> str:
    if field.length == 0 and field.kind == "uint8":
        return "bytes"
    if field.length == 0:
        return f"tuple[{_type(field._replace(length=None))}, ...]"
    if field.length is not None:
        return _tuple([_type(field._replace(length=None))] * field.length)
    if field.kind in (HEADER_TYPE, *TIME_TYPES):
        return "int"
    if field.kind in CODES:
        return _PYTHON.get(CODES[field.kind], "int")
    if field.kind == "string":
        return "str"
    return _tuple([_type(each) for each in fields_of(field.kind)])


def _tuple(types: list[str]) -> str:
    if set(types) == {"float"} and len(types) in (3, 4):
        return f"Vec{len(types)}"
    return f"tuple[{', '.join(types)}]"


if __name__ == "__main__":
    STUB.write_text(text(), encoding="ascii")
