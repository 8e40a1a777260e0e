"""Inputs and snapshots go into the log as any ROS 2 codec would write them, and come back to the bit."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.types import Inputs, Landed, Mode, Operator, OwnState, TargetSample, VehicleStatus
from logs.schema import codec_input as codec
from logs.schema import schemas

STORE = schemas.typestore()
T = STORE.types

stamps = st.integers(0, (2**31 - 1) * 10**9)
bits = st.integers(0, 2**64 - 1).map(lambda n: struct.unpack("<d", struct.pack("<Q", n))[0])
floats = st.one_of(st.sampled_from([0.0, -0.0, float("inf"), float("-inf")]), bits)
vec3 = st.tuples(floats, floats, floats)
u64 = st.integers(0, 2**64 - 1)
texts = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=20)
owns = st.builds(OwnState, floats, floats, vec3, vec3, floats)
statuses = st.builds(
    VehicleStatus, floats, st.booleans(), st.sampled_from(Mode), st.sampled_from(Landed), st.booleans()
)
samples = st.builds(TargetSample, floats, floats, texts, texts, vec3, vec3, floats, floats, floats, floats)
inputs = st.builds(
    Inputs,
    st.none() | owns,
    st.none() | statuses,
    st.lists(samples, max_size=4).map(tuple),
    st.sampled_from(Operator),
)


def header(stamp_ns):
    stamp = T["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return T["std_msgs/msg/Header"](stamp=stamp, frame_id="map")


def vector(v):
    return T["geometry_msgs/msg/Vector3"](x=v[0], y=v[1], z=v[2])


def as_message(stamp_ns, tick, now_s, given, failed):
    own = given.own or OwnState(0.0, 0.0, (0.0,) * 3, (0.0,) * 3, 0.0)
    status = given.status or VehicleStatus(0.0, False, Mode.UNKNOWN, Landed.UNKNOWN, False)
    return T[schemas.CONTROLLER_INPUT](
        header=header(stamp_ns), tick=tick, now_s=now_s, operator=given.operator, command_failed=failed,
        own_present=given.own is not None, status_present=given.status is not None,
        armed=status.armed, mode=status.mode, landed=status.landed, ready_to_arm=status.ready_to_arm,
        status_arrival_s=status.arrival_s, own_arrival_s=own.arrival_s, own_source_time_s=own.source_time_s,
        own_position_enu_m=vector(own.position_enu_m), own_velocity_enu_m_s=vector(own.velocity_enu_m_s),
        own_yaw_rad=own.yaw_rad,
        target_samples=[
            T[schemas.TARGET_SAMPLE](
                frame_id=s.frame_id, child_frame_id=s.child_frame_id, arrival_s=s.arrival_s,
                source_time_s=s.source_time_s, position_enu_m=vector(s.position_enu_m),
                velocity_enu_m_s=vector(s.velocity_enu_m_s), yaw_rad=s.yaw_rad,
                yaw_rate_rad_s=s.yaw_rate_rad_s, position_sigma_m=s.position_sigma_m,
                velocity_sigma_m_s=s.velocity_sigma_m_s,
            )
            for s in given.target_samples
        ],
    )  # fmt: skip


@given(stamps, u64, floats, inputs, st.booleans())
def test_inputs_equal_the_generic_codec_and_come_back_to_the_bit(stamp_ns, tick, now_s, given, failed):
    data = codec.pack_controller_input(stamp_ns, tick, now_s, given, failed)
    message = as_message(stamp_ns, tick, now_s, given, failed)
    assert data == bytes(STORE.serialize_cdr(message, schemas.CONTROLLER_INPUT))
    row = codec.unpack_controller_input(data)
    assert (row.stamp_ns, row.tick, row.command_failed) == (stamp_ns, tick, failed)
    assert type(row.inputs.operator) is Operator
    # NaN equals nothing, so bits are compared by packing again
    assert codec.pack_controller_input(*row) == data


@given(stamps, u64, texts, texts)
def test_snapshots_equal_the_generic_codec(stamp_ns, tick, layout, state):
    data = codec.pack_controller_state(stamp_ns, tick, layout, state)
    message = T[schemas.CONTROLLER_STATE](header=header(stamp_ns), tick=tick, layout=layout, state=state)
    assert data == bytes(STORE.serialize_cdr(message, schemas.CONTROLLER_STATE))
    assert codec.unpack_controller_state(data) == (stamp_ns, tick, layout, state)


@given(inputs, st.data())
def test_a_cut_or_lengthened_payload_is_refused(given, data):
    whole = codec.pack_controller_input(1, 2, 3.0, given, False)
    cut = data.draw(st.integers(0, len(whole) - 1))
    for bad in (whole[:cut], whole + b"\x00"):
        with pytest.raises(ValueError, match=r"ControllerInput|cut short"):
            codec.unpack_controller_input(bad)


@given(st.binary(max_size=400))
def test_garbage_is_a_value_error(garbage):
    for unpack in (codec.unpack_controller_input, codec.unpack_controller_state):
        with pytest.raises(ValueError, match=r"."):
            unpack(garbage)


def test_constants_of_the_definition_match_the_stack():
    text = schemas.schema_text(schemas.CONTROLLER_INPUT)
    for prefix, enum in (("OPERATOR", Operator), ("MODE", Mode), ("LANDED", Landed)):
        written = [line.split()[1] for line in text.splitlines() if line.startswith(f"uint8 {prefix}_")]
        assert written == [f"{prefix}_{member.name}={member.value}" for member in enum]
