"""Raw frames are recorded exactly as a generic ROS 2 codec would write them, and lose nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from logs.schema import schemas
from logs.schema.cdr import codec
from logs.schema.codec_mavlink import FrameError, pack_mavlink, unpack_mavlink

STORE = schemas.typestore()
stamps = st.integers(0, (2**31 - 1) * 10**9)


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
    data = pack_mavlink(stamp_ns, frame)
    assert unpack_mavlink(data) == (stamp_ns, frame)
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
    data = pack_mavlink(5_000_000_001, frame)
    message = STORE.deserialize_cdr(data, schemas.MAVLINK)
    assert (message.magic, message.sysid, message.compid, message.msgid) == (0xFD, 7, 42, 0)
    assert message.incompat_flags == 1
    assert message.checksum == int.from_bytes(frame[-15:-13], "little")
    assert bytes(message.signature) == frame[-13:]
    assert unpack_mavlink(data) == (5_000_000_001, frame)


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
    with pytest.raises(FrameError, match="not one whole MAVLink frame"):
        pack_mavlink(0, bad)


@given(frames(), st.data())
def test_cut_frame_record_is_refused(frame, data):
    record = pack_mavlink(1, frame)
    cut = data.draw(st.integers(0, len(record) - 1))
    with pytest.raises(FrameError):
        unpack_mavlink(record[:cut])


@given(st.binary(max_size=400))
def test_garbage_is_refused_with_a_value_error(garbage):
    with pytest.raises(ValueError, match=r"."):
        unpack_mavlink(garbage)


@given(stamps, frames())
def test_the_packer_made_from_the_definition_writes_the_same(stamp_ns, frame):
    data = pack_mavlink(stamp_ns, frame, b"p00")
    pack, unpack = codec(schemas.MAVLINK, frame_id=None)
    values = unpack(data)
    assert values[0] == (stamp_ns, "p00")
    assert pack(values) == data
