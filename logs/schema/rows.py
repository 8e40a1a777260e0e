"""Rows of the log: a named tuple for each message type, made from its definition.

The ``.msg`` files in ``msg/`` are the definitions; this module makes the rows in ``ROWS`` from them at
import, and ``LogRow`` from a ROS 2 type. ``FleetEcho``, ``ReceivedStatus`` and ``TargetSample`` are elements
of other rows, and ``Mavlink`` is a raw frame. A row has the fields of its file, whose comments state units
and frames; the header becomes ``stamp_ns``, integer nanoseconds (Unix time, or simulated time from 2020-01-01
on in lockstep).
``row.pack()`` converts a row to CDR, ``Row.unpack(data)`` CDR to a row. The columns are the same fields as
numpy arrays of shape (n,), or (n, 3) for a vector and (n, 4) for a quaternion.

``rows.pyi`` has the types for mypy and is generated: run ``python -m tests.unit.logs.row_stubs`` after a
change of a definition. A test compares both.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import make_dataclass
from typing import Any

from bridge.ros2.codec import CODES, HEADER_TYPE, TIME_TYPES
from logs.schema.schemas import COLUMNS, ROWS, Field, codec, fields_of


def class_name(schema: str, end: str) -> str:
    """Return the class name of a message type, for example ``ControllerStepRow``."""
    return schema.rpartition("/")[2] + end


def value_name(field: Field) -> str:
    if field.kind == HEADER_TYPE:
        return "stamp_ns"
    return f"{field.name}_ns" if field.kind in TIME_TYPES else field.name


def column_type(field: Field) -> str:
    """Return the type name of a field's array."""
    code = CODES.get(field.kind, "d")
    return {"?": "Bools", "d": "Floats", "f": "Floats"}.get(code, "Ints")


def column_fields(schema: str) -> list[tuple[str, str]]:
    """Return names and types of a message type's arrays; ``t_s``, the log time, replaces the header."""
    numbers = [field for field in fields_of(schema) if field.kind != HEADER_TYPE]
    return [("t_s", "Floats"), *((field.name, column_type(field)) for field in numbers)]


def _row(schema: str) -> Any:
    name = class_name(schema, "Row")
    made: Any = namedtuple(name, map(value_name, fields_of(schema)), module=__name__)
    made.__doc__ = f"Fields, units and constants as in ``{schema}``."
    made.pack, unpack = codec(schema, make=made._make)
    made.unpack = staticmethod(unpack)
    return made


def _columns(schema: str) -> Any:
    name, module = class_name(schema, "Columns"), {"__module__": __name__}
    return make_dataclass(name, column_fields(schema), frozen=True, namespace=module)


globals().update({class_name(schema, "Row"): _row(schema) for schema in ROWS})
globals().update({class_name(schema, "Columns"): _columns(schema) for schema in COLUMNS})
