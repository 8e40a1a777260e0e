"""Tests raw frames in the log: same bytes as from a generic codec, no loss, same values as pymavlink."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as everything
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.messages import MESSAGES, decode
from logs.recorder.derive import TOPICS_MAX, frame_decoder
from logs.schema import schemas
from logs.schema.mavlink import MAVLINK_PEERS, NAMED_MAX, OTHERS, PeerNames, pack_mavlink, unpack_mavlink
from tests.examples import examples

STORE = schemas.typestore()
stamps = st.integers(0, (2**31 - 1) * 10**9)


@st.composite
def frames(draw):
    payload = draw(st.binary(max_size=255))
    tail = draw(st.binary(min_size=2, max_size=2))
    flags = draw(st.sampled_from([0, 1]))
    rest = draw(st.binary(min_size=7, max_size=7))
    signature = draw(st.binary(min_size=13, max_size=13)) if flags else b""
    return bytes([0xFD, len(payload), flags]) + rest + payload + tail + signature


@given(stamps, frames(), st.sampled_from(["", "p00"]))
def test_frame_round_trip_is_lossless_and_equals_the_generic_codec(stamp_ns, frame, peer):
    data = pack_mavlink(stamp_ns, frame, peer)
    assert unpack_mavlink(data) == (stamp_ns, peer, frame)
    decoded = STORE.deserialize_cdr(data, schemas.MAVLINK)
    assert bytes(STORE.serialize_cdr(decoded, schemas.MAVLINK)) == data
    assert decoded.len == frame[1]
    assert decoded.header.frame_id == peer
    assert decoded.payload64.astype("<u8").tobytes()[: decoded.len] == frame[10 : 10 + frame[1]]


@given(frames(), st.data())
def test_cut_frame_record_is_refused(frame, data):
    record = pack_mavlink(1, frame)
    cut = data.draw(st.integers(0, len(record) - 1))
    with pytest.raises(ValueError, match="Mavlink"):
        unpack_mavlink(record[:cut])


LINK = mav.MAVLink(None, srcSystem=1, srcComponent=1)
PARSER = everything.MAVLink(None)
STAMP_NS = 1_577_836_800_123_456_789
ROS_FIELD = re.compile(r"[a-z](_?[a-z0-9])*")  # field names that ROS 2 allows
ROS_TYPE = re.compile(r"[A-Z][A-Za-z0-9]*")


def framed(number, payload, sequence=0, system=1, component=1):
    """Return a frame with this payload and a valid checksum; zeros at the payload's end are omitted."""
    payload = payload.rstrip(b"\x00") or payload[:1]
    head = bytes([len(payload), 0, 0, sequence, system, component]) + number.to_bytes(3, "little")
    crc = mav.x25crc(head + payload)
    crc.accumulate(bytes([MESSAGES[number].crc_extra]))
    return b"\xfd" + head + payload + crc.crc.to_bytes(2, "little")


def decoded(frame, peer="p00"):
    """Decode a frame as the recorder does; return (topic, schema, message)."""
    decoder = frame_decoder("/cf1/mavlink_source")
    ((topic, schema, data),) = decoder(0, pack_mavlink(STAMP_NS, frame, peer))
    store = schemas.store_for(schema)
    message = store.deserialize_cdr(data, schema)
    assert bytes(store.serialize_cdr(message, schema)) == data
    return topic, schema, message


def test_every_message_of_the_dialect():
    for number in sorted(MESSAGES):
        cls = MESSAGES[number]
        rng = np.random.default_rng(number)
        known, _ = schemas.mavlink_class(number)
        assert ROS_TYPE.fullmatch(known.removeprefix("mavlink_msgs/msg/"))
        header, *fields = schemas.fields_of(known)
        assert header.name == "header"
        assert len({f.name for f in fields}) == len(fields)
        for _ in range(3):
            payload = bytes(
                rng.integers(1, 127, cls.unpacker.size, dtype=np.uint8)
            )  # without zeros, texts have their full length
            frame = framed(number, payload)
            theirs = PARSER.decode(bytearray(frame)) if number in everything.mavlink_map else decode(frame)
            topic, schema, ours = decoded(frame)
            assert (topic, schema) == (f"/cf1/mavlink/sys1/comp1/{cls.msgname}", known)
            assert (ours.header.stamp.sec, ours.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
            for name, field in zip(cls.ordered_fieldnames, fields, strict=True):
                assert ROS_FIELD.fullmatch(field.name)
                value, seen = getattr(theirs, name), getattr(ours, field.name)
                if isinstance(value, list):
                    assert list(seen) == value, name
                else:
                    assert seen == (ord(value) if isinstance(value, str) and field.kind == "uint8" else value)


@given(st.binary(max_size=50))
@examples(60)
def test_text_of_any_bytes_stays_readable(raw):
    text = raw.partition(b"\x00")[0].decode("utf-8", "replace")
    frame = framed(253, bytes([4]) + raw.ljust(50, b"\x00") + b"\x01\x00\x02")
    _, _, ours = decoded(frame)
    assert (ours.severity, ours.text, ours.id, ours.chunk_seq) == (4, text, 1, 2)


def test_nan_and_frames_without_a_name():
    message = mav.MAVLink_attitude_message(1, math.nan, 0.5, 0, 0, 0, 0)
    _, _, ours = decoded(message.pack(LINK))
    assert math.isnan(ours.roll)
    assert ours.pitch == 0.5
    other = mav.MAVLink(None, srcSystem=9, srcComponent=8)
    frame = mav.MAVLink_heartbeat_message(2, 12, 81, 5, 3, 3).pack(other)
    topic, _, beat = decoded(frame, "")
    assert topic == "/cf1/mavlink/sys9/comp8/HEARTBEAT"
    assert (beat.custom_mode, beat.base_mode, beat.header.frame_id) == (5, 81, "p--")


def test_what_the_dialect_does_not_know_is_left_to_the_raw_topic():
    frame = b"\xfd\x01\x00\x00\x00\x01\x01\xff\xff\xff\x00ab"
    assert frame_decoder("/cf1/mavlink_source")(0, pack_mavlink(1, frame)) == []
    with pytest.raises(ValueError, match="begins with"):
        frame_decoder("/cf1/mavlink_source")(0, b"\x00\x01\x00\x00")


def test_topics_are_bounded_and_named_after_the_run():
    decoder = frame_decoder("/uas1/mavlink_source")
    topics = set()
    for system in range(1, 256):
        for component in (1, 2, 3):
            frame = framed(0, bytes(8) + b"\x03", system=system, component=component)
            topics |= {t for t, _, _ in decoder(0, pack_mavlink(1, frame, "p00"))}
    assert len(topics) == TOPICS_MAX
    assert "/uas1/mavlink/sys1/comp1/HEARTBEAT" in topics
    decoder = frame_decoder("/uas1/mavlink_source", {"uas1": "lab/cf7"})
    ((topic, _, _),) = decoder(0, pack_mavlink(1, framed(0, bytes(8) + b"\x03"), "p00"))
    assert topic == "/lab/cf7/mavlink/sys1/comp1/HEARTBEAT"


def test_frames_name_their_peer():
    written = {}
    names = PeerNames(lambda name, values: written.update(values) if name == MAVLINK_PEERS else None)
    first, second = ("127.0.0.1", 14550), ("10.0.0.2", 14551)
    assert [names(first), names(second), names(first)] == ["p00", "p01", "p00"]
    assert written == {"p00": "127.0.0.1:14550", "p01": "10.0.0.2:14551"}
    for port in range(200):
        last = names(("10.0.0.9", port))
    assert last == OTHERS
    assert len(written) == NAMED_MAX
