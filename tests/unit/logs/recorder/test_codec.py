"""The hand packers write exactly what a generic ROS 2 codec writes, and lose nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from logs.schema import codec, schemas

STORE = schemas.typestore()
T = STORE.types

stamps = st.integers(0, (2**31 - 1) * 10**9)
floats = st.floats(width=64)
vec3 = st.tuples(floats, floats, floats)
vec4 = st.tuples(floats, floats, floats, floats)
u8, u32, u64 = st.integers(0, 255), st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1)
texts = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=20)

BY_NAME = {
    "stamp_ns": stamps, "tick": u64, "phase": u8, "request": u8, "filter_status": u8, "gate": u8,
    "iterations": u32, "target_accepted": u32, "target_rejected": u32, "overruns": u32,
    "feed_dropped": u32, "contacts": u32,
}  # fmt: skip
BY_TYPE = {"int": u64, "bool": st.booleans(), "float": floats, "Vec3": vec3, "Vec4": vec4}


def rows(row_type):
    kinds = {name: kind.__forward_arg__ for name, kind in row_type.__annotations__.items()}
    return st.builds(row_type, **{n: BY_NAME[n] if n in BY_NAME else BY_TYPE[k] for n, k in kinds.items()})


def header(stamp_ns, frame_id):
    stamp = T["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def as_message(row, name):
    """Build the message of a row with the generic codec's classes, field by field by name."""
    values = {}
    for field, _ in STORE.fielddefs[name][1]:
        if field == "header":
            values[field] = header(row.stamp_ns, "map")
        elif field == "orientation":
            x, y, z, w = row.orientation_xyzw
            values[field] = T["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
        elif field == "rotor_rpm":
            values[field] = np.array(row.rotor_rpm, dtype=np.float64)
        elif isinstance(value := getattr(row, field), tuple):
            values[field] = T["geometry_msgs/msg/Vector3"](x=value[0], y=value[1], z=value[2])
        else:
            values[field] = value
    return T[name](**values)


@given(rows(codec.ControllerStepRow))
def test_controller_step_equals_the_generic_codec(row):
    data = codec.pack_controller_step(row)
    assert data == bytes(
        STORE.serialize_cdr(as_message(row, schemas.CONTROLLER_STEP), schemas.CONTROLLER_STEP)
    )
    assert codec.pack_controller_step(codec.unpack_controller_step(data)) == data


@given(rows(codec.LoopTimingRow))
def test_loop_timing_equals_the_generic_codec(row):
    data = codec.pack_loop_timing(row)
    assert data == bytes(STORE.serialize_cdr(as_message(row, schemas.LOOP_TIMING), schemas.LOOP_TIMING))
    assert codec.pack_loop_timing(codec.unpack_loop_timing(data)) == data


@given(rows(codec.TrueStateRow))
def test_true_state_equals_the_generic_codec(row):
    data = codec.pack_true_state(row)
    assert data == bytes(STORE.serialize_cdr(as_message(row, schemas.TRUE_STATE), schemas.TRUE_STATE))
    assert codec.pack_true_state(codec.unpack_true_state(data)) == data


@given(stamps, st.sampled_from(codec.Severity), texts, texts, texts, texts, u32)
def test_log_equals_the_generic_codec(stamp_ns, level, name, message, file, function, line):
    data = codec.pack_log(stamp_ns, level, name, message, file, function, line)
    stamp = header(stamp_ns, "").stamp
    generic = T[schemas.LOG](
        stamp=stamp, level=level, name=name, msg=message, file=file, function=function, line=line
    )
    assert data == bytes(STORE.serialize_cdr(generic, schemas.LOG))
    assert codec.unpack_log(data) == (stamp_ns, level, name, message, file, function, line)


@st.composite
def frames(draw):
    version = draw(st.sampled_from([1, 2]))
    payload = draw(st.binary(max_size=255))
    tail = draw(st.binary(min_size=2, max_size=2))
    if version == 1:
        return bytes([0xFE, len(payload)]) + draw(st.binary(min_size=4, max_size=4)) + payload + tail
    flags = draw(st.sampled_from([0, 1]))
    rest = draw(st.binary(min_size=7, max_size=7))
    signature = draw(st.binary(min_size=13, max_size=13)) if flags else b""
    return bytes([0xFD, len(payload), flags]) + rest + payload + tail + signature


@given(stamps, frames())
def test_frame_round_trip_is_lossless_and_equals_the_generic_codec(stamp_ns, frame):
    data = codec.pack_mavlink(stamp_ns, frame)
    assert codec.unpack_mavlink(data) == (stamp_ns, frame)
    decoded = STORE.deserialize_cdr(data, schemas.MAVLINK)
    assert bytes(STORE.serialize_cdr(decoded, schemas.MAVLINK)) == data
    assert decoded.len == frame[1]
    payload = frame[10 : 10 + frame[1]] if frame[0] == 0xFD else frame[6 : 6 + frame[1]]
    assert decoded.payload64.astype("<u8").tobytes()[: decoded.len] == payload


def test_fields_of_a_real_signed_frame():
    link = mav.MAVLink(None, srcSystem=7, srcComponent=42)
    link.signing.sign_outgoing = True
    link.signing.secret_key = bytes(range(32))
    link.signing.timestamp = 123456
    frame = link.heartbeat_encode(2, 12, 0, 0, 3).pack(link)
    data = codec.pack_mavlink(5_000_000_001, frame)
    message = STORE.deserialize_cdr(data, schemas.MAVLINK)
    assert (message.magic, message.sysid, message.compid, message.msgid) == (0xFD, 7, 42, 0)
    assert message.incompat_flags == 1
    assert message.checksum == int.from_bytes(frame[-15:-13], "little")
    assert bytes(message.signature) == frame[-13:]
    assert codec.unpack_mavlink(data) == (5_000_000_001, frame)


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"\xfd",
        b"\xfd\x03" + bytes(10),  # payload missing
        b"\xfd\x00" + bytes(11),  # one byte too many
        b"\xfd\x00\x01" + bytes(9),  # signature missing
        b"\xfe\x05" + bytes(6),
        bytes(12),
    ],
)
def test_not_a_frame_is_refused(bad):
    with pytest.raises(codec.FrameError, match="not one whole MAVLink frame"):
        codec.pack_mavlink(0, bad)


@given(frames(), st.data())
def test_cut_frame_record_is_refused(frame, data):
    record = codec.pack_mavlink(1, frame)
    cut = data.draw(st.integers(0, len(record) - 1))
    with pytest.raises(codec.FrameError):
        codec.unpack_mavlink(record[:cut])


@given(st.binary(max_size=400))
def test_unpackers_refuse_garbage_with_a_value_error(garbage):
    for unpack in (
        codec.unpack_controller_step,
        codec.unpack_loop_timing,
        codec.unpack_true_state,
        codec.unpack_log,
        codec.unpack_mavlink,
    ):
        with pytest.raises(ValueError, match=r"."):
            unpack(garbage)


def test_absent_values_survive():
    row = codec.LoopTimingRow(0, 1, math.nan, math.inf, -math.inf, 0.0, 0, 0)
    back = codec.unpack_loop_timing(codec.pack_loop_timing(row))
    assert math.isnan(back.period_s)
    assert (back.lateness_s, back.exec_s) == (math.inf, -math.inf)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # micro_ros_arduino odometry__struct.h and the design document of rmw_zenoh
        (schemas.ODOMETRY, "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
        ("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
    ],
)
def test_type_hashes(name, expected):
    assert schemas.type_hash(name) == expected


def test_schema_texts_are_complete_and_plain():
    for name in (schemas.CONTROLLER_STEP, schemas.LOOP_TIMING, schemas.TRUE_STATE, schemas.MAVLINK):
        text = schemas.schema_text(name)
        assert text.isascii()
        assert "=" * 80 + "\nMSG: std_msgs/Header\n" in text
        assert "\nMSG: builtin_interfaces/Time\n" in text
    assert "# m, barrier, paper eq. (9)" in schemas.schema_text(schemas.CONTROLLER_STEP)


def test_enum_constants_match_the_stack():
    from flightstack.core.types import Phase, Request

    text = schemas.schema_text(schemas.CONTROLLER_STEP)
    for prefix, enum in (("PHASE", Phase), ("REQUEST", Request)):
        written = [line.split()[1] for line in text.splitlines() if line.startswith(f"uint8 {prefix}_")]
        assert written == [f"{prefix}_{member.name}={member.value}" for member in enum]


def test_unknown_schema_is_a_clear_error():
    with pytest.raises(schemas.UnknownSchemaError, match="no_msgs/msg/Nothing"):
        schemas.schema_text("no_msgs/msg/Nothing")
