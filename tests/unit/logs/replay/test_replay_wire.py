"""Tests the replay of recorded MAVLink and Zenoh data through the current bridge."""

import itertools
from dataclasses import replace as with_

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.ros2.cdr import OdometryError
from bridge.target.odometry import RawSample, sample_of
from flightstack.core.types import Inputs
from logs.compare import Tally
from logs.reader.reader import LogFile
from logs.replay.read import FlightInputs, TickRecord
from logs.replay.replay import replay
from logs.replay.wire import WireReplay
from logs.schema.controller_rows import TickInputs
from logs.schema.events import ONBOARD
from logs.schema.mavlink import pack_mavlink, unpack_mavlink
from logs.schema.rows import LogRow
from tests.golden.flights import path_of, write_kept
from tests.point_mass import World
from tests.unit.logs.replay.replay_helpers import CONFIG, record
from tests.unit.mavlink.codec.frames_of_messages import packed

pytestmark = pytest.mark.slow

GOLDEN = path_of("contact")
SOURCE, SINK = "/uas1/mavlink_source", "/uas1/mavlink_sink"

POSITION, ANSWER = dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_TIMESYNC
SKIPPED = 200  # number of the changed frame among the frames of its kind; the vehicle flies then
PAYLOAD_AT = 10  # offset of the payload in a MAVLink 2 frame, bytes


def frame_changed(target, topic, message_id, byte):
    """Return the golden log with one changed byte in the payload of the 200th frame of a kind."""
    seen = 0

    def change(message):
        nonlocal seen
        if message.topic != topic:
            return message.data
        stamp_ns, peer, frame = unpack_mavlink(message.data)
        seen += frame[7] == message_id
        if frame[7] != message_id or seen != SKIPPED:
            return message.data
        changed = bytearray(frame)
        changed[PAYLOAD_AT + byte] ^= 1
        checked = bytes(changed[1:-2]) + bytes([dialect.mavlink_map[message_id].crc_extra])
        changed[-2:] = dialect.x25crc(checked).crc.to_bytes(2, "little")
        seen += 1
        return pack_mavlink(stamp_ns, bytes(changed), peer)

    write_kept(GOLDEN, target, change=change)
    assert seen > SKIPPED
    return target


def misread(path):
    """Return the first differences between the recorded inputs and those computed from the frames."""
    flight = FlightInputs(path)
    wire = WireReplay(flight, flight.config(), found := Tally())
    for tick in flight.ticks():
        wire.take(tick, tick.given)
    return found.first


def test_the_golden_wire_gives_the_recorded_inputs():
    assert misread(GOLDEN) == []
    log = LogFile(GOLDEN)
    assert sum(m.topic == SOURCE for m in log.messages()) > 1000
    assert sum(m.topic == SINK for m in log.messages()) > 300


@pytest.mark.parametrize(
    ("byte", "field"),
    [
        (4, "own.position_enu_m[1]"),  # byte 4: x (north) of LOCAL_POSITION_NED
        (8, "own.position_enu_m[0]"),  # byte 8: y (east)
        (12, "own.position_enu_m[2]"),  # byte 12: z (down)
        (24, "own.velocity_enu_m_s[2]"),
        (0, "own.source_time_s"),
    ],
)
def test_a_changed_bit_of_the_vehicles_position_means_other_inputs(tmp_path, byte, field):
    found = misread(frame_changed(tmp_path / "changed.mcap", SOURCE, POSITION, byte))
    assert {d.field for d in found} == {field}
    assert {d.topic for d in found} == {"wire, inputs"}
    assert len(found) <= 2


def once(topic, number, change):
    """Return a function that changes the message ``number`` of a topic; the first message has number 1."""
    seen = itertools.count(1)
    return lambda m: change(m.data) if m.topic == topic and next(seen) == number else m.data


def test_a_changed_bit_of_the_targets_odometry_means_other_inputs(tmp_path):
    def change(data):
        at = data.index(b"target\x00") + 7  # the pose follows, aligned to eight bytes
        at += (4 - at) % 8
        return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]

    changed = write_kept(GOLDEN, tmp_path / "changed.mcap", change=once("/cf1/target/odom", 150, change))
    (found,) = misread(changed)
    assert found.field == "target_samples[0].position_enu_m[0]"


def test_frames_after_the_last_tick_belong_to_none(tmp_path):
    """Frames that were sent after the last tick, as by a process that ends, belong to no tick."""
    frame = packed(dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 0, 1, 191)
    path = record(tmp_path / "flight.mcap", World(CONFIG, position=(-0.6, 0.2, 0.95)), 0.3, after=(frame,))
    *ticks, rest = FlightInputs(path).ticks()
    assert len(ticks) == replay(path).compared == 30
    assert not any(tick.frames_out for tick in ticks)
    assert (rest.given, rest.frames_out) == (None, [frame])


def test_a_changed_frame_to_the_vehicle_is_found(tmp_path):
    before, result = replay(GOLDEN), replay(frame_changed(tmp_path / "changed.mcap", SINK, ANSWER, 4))
    assert result.outputs.count == before.outputs.count
    assert result.wire.count == before.wire.count + 1
    assert SINK in {d.topic for d in result.wire.first}


def test_a_frame_that_came_from_another_address_is_ignored_as_in_the_flight(tmp_path):
    def change(message):
        if (
            message.topic != SOURCE
            or unpack_mavlink(message.data).message_id != dialect.MAVLINK_MSG_ID_VFR_HUD
        ):
            return message.data
        hello = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
        stamp_ns, _, frame = unpack_mavlink(message.data)
        return pack_mavlink(stamp_ns, packed(hello, frame[4], 1, 1), "p07")

    found = misread(write_kept(GOLDEN, tmp_path / "changed.mcap", change=change))
    assert {d.field for d in found} == {"status.ready_to_arm"}  # the heartbeat may come from a second vehicle


def tick_of(odometry, said):
    given = TickInputs(0, 0, 0.0, Inputs(), False)
    return TickRecord(
        0, given=given, odometry=odometry, said=[LogRow(0, 30, ONBOARD, t, "", "", 0) for t in said]
    )


def take_problem(payload):
    with pytest.raises(OdometryError) as error:
        sample_of(RawSample(payload), 0.0)
    return [f"target sample refused: {error.value}"]


def test_samples_that_never_decoded_do_not_disturb_and_their_refusal_is_compared():
    payload = next(m.data for m in LogFile(GOLDEN).messages({"/cf1/target/odom"}))
    (refusal,) = take_problem(b"\x00\x01\x02")
    for said, count in (
        ([refusal], 0),
        ([], 1),
        ([refusal + "!"], 1),
        (["frames of other systems ignored: 2"], 1),
        ([refusal, "waiting: no sample on cf1/target/odom; gives up within 9 s (checks.wait_time_max_s)"], 0),
        ([refusal, "no heartbeat of system 1, component 1 for 4 s: no data arrives"], 0),
    ):
        record = tick_of([b"\x00\x01\x02", payload], said)
        WireReplay(FlightInputs(GOLDEN), CONFIG, found := Tally()).take(record, record.given)
        assert sum(d.topic == "/rosout" for d in found.first) == count, found
        assert [d.field for d in found.first if d.topic == "wire, inputs"] == ["target_samples.length"]


def test_with_another_configuration_or_without_frames_the_wire_is_left_out(tmp_path):
    config = FlightInputs(GOLDEN).config()
    assert replay(GOLDEN, with_(config)).wire is None
    bare = replay(write_kept(GOLDEN, tmp_path / "bare.mcap", wire=False))
    assert bare.wire is None
    assert any("wire not replayed" in note for note in bare.notes)
