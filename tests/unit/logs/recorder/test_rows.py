"""Tests rows: same bytes as from a generic ROS 2 codec, no loss, and data of wrong types are rejected."""

from __future__ import annotations

import dataclasses
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.ros2 import codec as cdr
from flightstack.core.types import (
    FilterStatus,
    Inputs,
    Intent,
    Landed,
    Mode,
    Operator,
    OwnState,
    Phase,
    Request,
    TargetSample,
    VehicleStatus,
)
from logs.reader.flight_data import Steps
from logs.schema import rows, schemas
from logs.schema.controller_rows import TickInputs, pack_controller_input, unpack_controller_input
from logs.schema.rows import ControllerInputRow, ControllerStepRow, LoopTimingRow
from logs.schema.schemas import fields_of
from tests.unit.logs import row_stubs as stubs

STORE = schemas.typestore()
T = STORE.types

STAMPS = st.integers(0, (2**31 - 1) * 10**9)
BITS = st.integers(0, 2**64 - 1).map(lambda n: struct.unpack("<d", struct.pack("<Q", n))[0])
TEXTS = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=20)
FLOATS = st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan]) | BITS
BY_CODE = {"?": st.booleans(), "d": FLOATS, "q": st.integers(-(2**63), 2**63 - 1)} | {
    code: st.integers(0, 2**bits - 1) for code, bits in (("B", 8), ("H", 16), ("I", 32), ("Q", 64))
}
ROWS = {name: getattr(rows, rows.class_name(name, "Row")) for name in rows.ROWS}


def values_of(field):
    """Return a Hypothesis strategy for the values of a field in a row."""
    if field.length == 0 and field.kind == "uint8":
        return st.binary(max_size=4)
    if field.length is not None:
        each = values_of(field._replace(length=None))
        size = {"max_size": 4} if field.length == 0 else {"min_size": field.length, "max_size": field.length}
        return st.lists(each, **size).map(tuple)
    if field.kind in (cdr.HEADER_TYPE, *cdr.TIME_TYPES):
        return STAMPS
    if field.kind == "string":
        return TEXTS
    if field.kind in cdr.CODES:
        return BY_CODE[cdr.CODES[field.kind]]
    return st.tuples(*map(values_of, fields_of(field.kind)))


def generic(field, value):
    """Convert the value of a field in a row to the type that the generic codec requires."""
    if field.length is not None and field.kind in cdr.CODES:
        return np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value)
    if field.length is not None:
        return [generic(field._replace(length=None), each) for each in value]
    if field.kind == cdr.HEADER_TYPE:
        return T[field.kind](stamp=generic(field._replace(kind=cdr.TIME_TYPES[0]), value), frame_id="map")
    if field.kind in cdr.TIME_TYPES:
        return T[field.kind](sec=value // 10**9, nanosec=value % 10**9)
    return value if field.kind in (*cdr.CODES, "string") else message(field.kind, value)


def message(schema, values):
    fields = fields_of(schema)
    return T[schema](**{f.name: generic(f, v) for f, v in zip(fields, values, strict=True)})


any_row = st.sampled_from(sorted(ROWS)).flatmap(
    lambda name: st.builds(ROWS[name]._make, st.tuples(*map(values_of, fields_of(name))))
)


def schema_of(row):
    return next(name for name, kind in ROWS.items() if type(row) is kind)


@given(any_row)
def test_every_row_equals_the_generic_codec_and_comes_back_to_the_bit(row):
    data, schema = row.pack(), schema_of(row)
    assert data == bytes(STORE.serialize_cdr(message(schema, row), schema))
    back = type(row).unpack(data)
    assert type(back) is type(row)
    assert back.pack() == data  # compare bits, because NaN does not equal itself
    assert [type(value) for value in back] == [type(value) for value in row]


@given(any_row, st.data())
def test_a_cut_or_lengthened_payload_is_refused(row, data):
    whole = row.pack()
    cut = data.draw(st.integers(0, len(whole) - 1))
    for bad in (whole[:cut], whole + b"\x00"):
        with pytest.raises(ValueError, match=f"not a {schema_of(row)} of this stack"):
            type(row).unpack(bad)


@pytest.mark.parametrize(
    ("at", "said"),
    [(1, "encoding"), (12, "frame"), (16, "frame")],
    ids=["big endian", "length", "other frame"],
)
def test_another_encoding_or_frame_is_named(at, said):
    data = bytearray(LoopTimingRow(0, 1, math.nan, math.inf, -math.inf, 0.0, 0, 0).pack())
    data[at] ^= 3
    with pytest.raises(ValueError, match=said):
        LoopTimingRow.unpack(bytes(data))


@pytest.mark.parametrize("name", cdr.standard_types())
def test_a_short_definition_of_a_standard_type_is_that_of_ros(name):
    text = STORE.generate_msgdef(name, ros_version=2)[0].split(cdr.SEPARATOR)[0]
    assert cdr.fields_of_text(text) == fields_of(name)


def test_the_stub_and_the_columns_are_those_of_the_definitions():
    assert stubs.STUB.read_text(encoding="ascii") == stubs.text(), "run python -m tests.unit.logs.row_stubs"
    names = [field.name for field in dataclasses.fields(Steps)]
    assert names == ["t_s", *ControllerStepRow._fields[1:]]


owns = st.builds(OwnState, FLOATS, FLOATS, *[st.tuples(FLOATS, FLOATS, FLOATS)] * 2, FLOATS)
statuses = st.builds(
    VehicleStatus, FLOATS, st.booleans(), st.sampled_from(Mode), st.sampled_from(Landed), st.booleans()
)
samples = st.builds(
    TargetSample, FLOATS, FLOATS, TEXTS, TEXTS, *[st.tuples(FLOATS, FLOATS, FLOATS)] * 2, *[FLOATS] * 4
)
inputs = st.builds(
    Inputs,
    st.none() | owns,
    st.none() | statuses,
    st.lists(samples, max_size=4).map(tuple),
    st.sampled_from(Operator),
    power=st.none(),  # stored in separate rows
    neighbours=st.just(()),  # stored in separate rows
)


@given(STAMPS, BY_CODE["Q"], FLOATS, inputs, st.booleans())
def test_inputs_come_back_to_the_bit(stamp_ns, tick, now_s, given, failed):
    data = pack_controller_input(TickInputs(stamp_ns, tick, now_s, given, failed))
    back = unpack_controller_input(data)
    assert (back.stamp_ns, back.tick, back.command_failed) == (stamp_ns, tick, failed)
    assert type(back.inputs.operator) is Operator
    assert repr(back.inputs) == repr(given)
    assert pack_controller_input(back) == data


def test_a_number_that_is_no_mode_is_refused():
    row = ControllerInputRow.unpack(pack_controller_input(TickInputs(0, 0, 0.0, Inputs(), False)))
    with pytest.raises(ValueError, match="99"):
        unpack_controller_input(row._replace(operator=99).pack())


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # sources: odometry__struct.h of micro_ros_arduino, and the design document of rmw_zenoh
        (schemas.ODOMETRY, "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
        ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    ],
)
def test_type_hashes(name, expected):
    assert schemas.type_hash(name) == expected


@pytest.mark.parametrize(
    ("schema", "prefix", "enum"),
    [
        (schemas.CONTROLLER_STEP, "PHASE", Phase),
        (schemas.CONTROLLER_STEP, "REQUEST", Request),
        (schemas.CONTROLLER_STEP, "FILTER", FilterStatus),
        (schemas.CONTROLLER_INPUT, "OPERATOR", Operator),
        (schemas.CONTROLLER_INPUT, "MODE", Mode),
        (schemas.CONTROLLER_INPUT, "LANDED", Landed),
        (schemas.RECEIVED_STATUS, "INTENT", Intent),
        (schemas.MEMBER_STATUS, "INTENT", Intent),
        (schemas.HEALTH, "MODE", Mode),
        (schemas.HEALTH, "LANDED", Landed),
    ],
)
def test_constants_match_the_stack(schema, prefix, enum):
    lines = schemas.schema_text(schema).splitlines()
    written = [line.split()[1] for line in lines if line.startswith(f"uint8 {prefix}_")]
    assert written == [f"{prefix}_{member.name}={member.value}" for member in enum]


def test_another_type_of_a_field_in_a_nested_message_is_noticed():
    text = schemas.schema_text(schemas.CONTROLLER_NEIGHBOURS)
    assert schemas.same_fields(schemas.CONTROLLER_NEIGHBOURS, text)
    other = text.replace("float64 position_sigma_m", "float32 position_sigma_m")
    assert not schemas.same_fields(schemas.CONTROLLER_NEIGHBOURS, other)
