"""Tests telemetry, parameters and the smaller MAVLink protocols of the server."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.client.texts import TextAssembler
from bridge.mavlink.server.commander import Text, Texts
from tests.unit.mavlink.codec.frames_of_messages import packed
from tests.unit.mavlink.server.served import ACCEPTED, COMPANION, DENIED, FAILED, NAN, UNSUPPORTED, as_long


def test_heartbeat_comes_once_a_second_and_at_once_on_a_change(served) -> None:
    served.run(3.0)
    beats = served.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)
    assert len(beats) == 3
    assert (beats[0].autopilot, beats[0].base_mode, beats[0].custom_mode) == (12, 29, 0x03040000)
    assert beats[0].system_status == mav.MAV_STATE_STANDBY
    served.run(0.33)
    before = len(served.seen(mav.MAVLINK_MSG_ID_HEARTBEAT))
    served.command(400, 1.0)
    served.run(0.02)
    (beat,) = served.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[before:]
    assert beat.base_mode == 157
    assert beat.system_status == mav.MAV_STATE_ACTIVE


def test_message_intervals_are_bounded_by_the_loop_and_can_be_switched_off(served) -> None:
    assert served.command(511, 31.0, 1.0) == ACCEPTED  # an interval of 1 us
    assert served.command(511, 32.0, 50_000.0) == ACCEPTED
    assert served.command(511, 30.0, -1.0) == ACCEPTED
    ack, interval = served.handle(as_long(510, (32.0,)))
    assert (ack.result, interval.interval_us) == (ACCEPTED, 50_000)
    served.run(0.1)
    before = {id_: len(served.seen(id_)) for id_ in (30, 31, 32)}
    served.run(1.0)
    counts = {id_: len(served.seen(id_)) - before[id_] for id_ in (30, 31, 32)}
    assert counts == {30: 0, 31: 100, 32: 20}
    assert served.command(511, 30.0, 0.0) == ACCEPTED
    before[30] = len(served.seen(30))
    served.run(0.1)
    assert len(served.seen(30)) - before[30] == 10
    assert served.command(511, 0.0, 1000.0) == FAILED  # the heartbeat rate is fixed
    assert served.command(511, 12345.0, 1000.0) == FAILED
    assert served.command(511, NAN, 1000.0) == FAILED


def test_messages_on_request(served) -> None:
    for id_ in served.server.messages:
        ack, message = served.handle(as_long(512, (float(id_),)))
        assert (ack.get_type(), ack.result, message.get_msgId()) == ("COMMAND_ACK", ACCEPTED, id_)
    assert {0, 1, 30, 31, 32, 147, 148, 242, 245} <= served.server.messages
    assert served.command(512, 435.0) == DENIED  # AVAILABLE_MODES: if accepted, QGC waits forever
    assert served.command(512, NAN) == DENIED
    for removed in (410, 519, 520, 525, 528):  # commands that PX4 1.18 removed
        assert served.command(removed, 1.0) == UNSUPPORTED


def values(served) -> list:
    return served.seen(mav.MAVLINK_MSG_ID_PARAM_VALUE)


def test_parameters_can_be_listed_and_read(served) -> None:
    served.handle(mav.MAVLink_param_request_list_message(1, 1))
    served.run(0.5)
    listed = values(served)
    assert [p.param_index for p in listed] == list(range(listed[0].param_count))
    assert all(len(p.param_id) <= 16 for p in listed)
    by_name = served.handle(mav.MAVLink_param_request_read_message(1, 1, b"MAV_SYS_ID", -1))[0]
    by_index = served.handle(mav.MAVLink_param_request_read_message(1, 1, b"", by_name.param_index))[0]
    assert by_index.param_id == by_name.param_id
    for name, index in ((b"NO_SUCH_THING", -1), (b"", 9999)):
        (missing,) = served.handle(mav.MAVLink_param_request_read_message(1, 1, name, index))
        assert (missing.get_type(), missing.error) == ("PARAM_ERROR", mav.MAV_PARAM_ERROR_DOES_NOT_EXIST)
        assert (missing.param_index, (missing.target_system, missing.target_component)) == (index, COMPANION)


def test_time_and_ping_are_answered(served) -> None:
    served.run(1.0)
    (sync,) = served.handle(mav.MAVLink_timesync_message(0, 77))
    boot_ms = served.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)[-1].time_boot_ms
    assert (sync.tc1, sync.ts1) == (pytest.approx(boot_ms * 1e6, abs=3e7), 77)
    assert served.handle(mav.MAVLink_timesync_message(5, 77)) == []
    (ping,) = served.handle(mav.MAVLink_ping_message(1, 2, 0, 0))
    assert (ping.target_system, ping.target_component, ping.seq) == (*COMPANION, 2)


def test_missions_logs_and_files_are_refused_at_once(served) -> None:
    def first(message):
        return served.handle(message)[0]

    for type_ in (0, 1, 2):
        count = first(mav.MAVLink_mission_request_list_message(1, 1, type_))
        assert (count.count, count.mission_type) == (0, type_)
        ack = first(mav.MAVLink_mission_count_message(1, 1, 0, type_))
        assert (ack.type, ack.mission_type) == (mav.MAV_MISSION_ACCEPTED, type_)
    for type_ in (0, 1, 2, 255):
        ack = first(mav.MAVLink_mission_clear_all_message(1, 1, type_))
        assert (ack.type, ack.target_system, ack.target_component) == (0, *COMPANION)
    item = mav.MAVLink_mission_item_int_message(1, 1, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 0, 0, 1.0, 0)
    for refused in (
        mav.MAVLink_mission_count_message(1, 1, 3, 0),
        mav.MAVLink_mission_request_list_message(1, 1, 7),
        item,
    ):
        assert first(refused).type == mav.MAV_MISSION_UNSUPPORTED
    for wanted in (
        mav.MAVLink_mission_request_message(1, 1, 0),
        mav.MAVLink_mission_request_int_message(1, 1, 3),
    ):
        assert first(wanted).type == mav.MAV_MISSION_INVALID_SEQUENCE
    assert first(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF)).num_logs == 0
    nak = first(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, [7, 0, 3, 4, 0, *[0] * 246]))
    assert list(nak.payload[:6]) == [8, 0, 3, 129, 1, 4]
    assert nak.payload[12] == 1


def test_messages_from_itself_and_of_no_interest_do_nothing(served) -> None:
    assert served.handle(as_long(400, (1.0,)), (1, 1)) == []
    assert served.handle(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []
    for number in range(300):  # pymavlink uses the name ``id`` for this field and for the message number
        assert served.handle(mav.MAVLink_statustext_message(6, b"hello", number)) == []
    assert not served.armed


@pytest.mark.parametrize("length", [1, 49, 50, 51, 100, 101, 180])
def test_long_texts_come_through(length: int) -> None:
    text, assembler, parser = "x" * length, TextAssembler(), mav.MAVLink(None)
    chunks = [parser.decode(bytearray(packed(m))) for m in Texts().messages(Text(4, text))]
    assert [c.chunk_seq for c in chunks] == list(range(len(chunks)))
    assert [t for chunk in chunks for t in assembler.add(chunk)] == [(4, text)]
