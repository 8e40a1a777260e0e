"""Telemetry, parameters and the small protocols; and that nothing from the network can break it."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import split_frames
from bridge.mavlink.server.profile import PX4_CODES, FlightMode
from tests.unit.autopilot.autopilot_fakes import (
    COMPANION,
    FEET_M,
    NAN,
    Rig,
    set_real,
)


def test_heartbeat_comes_once_a_second_and_at_once_on_a_change() -> None:
    rig = Rig()
    rig.run(3.0)
    beats = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)
    assert len(beats) == 3
    assert (beats[0].autopilot, beats[0].base_mode, beats[0].custom_mode) == (12, 29, 0x03040000)
    assert beats[0].system_status == mav.MAV_STATE_STANDBY
    rig.run(0.33)
    rig.telemetry.clear()
    rig.command(400, 1.0)
    rig.run(0.01)
    (beat,) = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)
    assert beat.base_mode == 157
    assert beat.system_status == mav.MAV_STATE_ACTIVE


def test_mode_codes_are_those_of_px4() -> None:
    assert {m: c.custom_mode for m, c in PX4_CODES.items()} == {
        FlightMode.HOLD: 0x03040000,
        FlightMode.TAKEOFF: 0x02040000,
        FlightMode.LAND: 0x06040000,
        FlightMode.RETURN: 0x05040000,
        FlightMode.OFFBOARD: 0x00060000,
    }


def test_position_and_attitude_come_at_every_tick_in_ned() -> None:
    rig = Rig()
    rig.vehicle.state.position_enu_m = (1.0, 2.0, FEET_M)
    rig.run(0.5)
    positions = rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert len(positions) == len(rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)) == 50
    assert (positions[0].x, positions[0].y, positions[0].z) == (2.0, 1.0, pytest.approx(-FEET_M))
    attitude = rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)[0]
    assert attitude.yaw == pytest.approx(math.pi / 2)  # nose to the east
    assert attitude.roll == pytest.approx(0.0)
    assert [m.time_boot_ms for m in positions[:3]] == [0, 10, 20]


def test_what_clients_wait_for_is_there_in_the_first_two_seconds() -> None:
    rig = Rig()
    rig.run(2.0)
    status = rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1]
    # gyro, accelerometer, magnetometer, GPS; and no fence that is broken
    wanted = 1 | 2 | 4 | 32 | mav.MAV_SYS_STATUS_GEOFENCE
    assert status.onboard_control_sensors_health & wanted == wanted
    assert status.onboard_control_sensors_health & mav.MAV_SYS_STATUS_PREARM_CHECK
    home = rig.seen(mav.MAVLINK_MSG_ID_HOME_POSITION)[0]
    assert home.altitude == 0
    for name in ("GLOBAL_POSITION_INT", "BATTERY_STATUS", "EXTENDED_SYS_STATE", "ATTITUDE_QUATERNION"):
        assert rig.seen(getattr(mav, f"MAVLINK_MSG_ID_{name}")), name


def test_infinite_parameters_and_nan_disguised_as_an_integer_are_denied() -> None:
    rig = Rig()
    assert rig.command(22, *[NAN] * 6, math.inf) == mav.MAV_RESULT_DENIED
    nan_int = mav.MAVLink_command_int_message(
        1, 1, 0, 22, 0, 0, NAN, NAN, NAN, NAN, 0x7FF80000, 0x7FF80000, 1.0
    )
    assert rig.handle(nan_int)[0].result == mav.MAV_RESULT_DENIED
    assert rig.mode is FlightMode.HOLD


def test_message_intervals_are_bounded_by_the_loop_and_can_be_switched_off() -> None:
    rig = Rig()
    assert rig.command(511, 331.0, 1.0) == mav.MAV_RESULT_ACCEPTED  # asks for 1 MHz
    assert rig.command(511, 32.0, 50_000.0) == mav.MAV_RESULT_ACCEPTED
    assert rig.command(511, 30.0, -1.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(1.0)
    assert len(rig.seen(331)) == 100
    assert len(rig.seen(32)) == 20
    assert not rig.seen(30)
    assert rig.command(511, 30.0, 0.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.1)
    assert len(rig.seen(30)) == 10
    assert rig.command(511, 0.0, 1000.0) == mav.MAV_RESULT_FAILED  # heartbeat
    assert rig.command(511, 12345.0, 1000.0) == mav.MAV_RESULT_FAILED
    assert rig.command(511, NAN, 1000.0) == mav.MAV_RESULT_FAILED


def test_messages_on_request() -> None:
    rig = Rig()
    ask = [*[NAN] * 6]
    replies = rig.handle(mav.MAVLink_command_long_message(1, 1, 512, 0, 242.0, *ask))
    assert [r.get_msgId() for r in replies] == [mav.MAVLINK_MSG_ID_COMMAND_ACK, 242]
    assert rig.command(512, 435.0) == mav.MAV_RESULT_DENIED  # AVAILABLE_MODES: a promise would hang QGC
    assert rig.command(512, NAN) == mav.MAV_RESULT_DENIED
    assert rig.command(520, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert rig.command(410) == mav.MAV_RESULT_ACCEPTED


def test_parameters_can_be_listed_read_and_set() -> None:
    rig = Rig()
    listed = rig.listed()
    assert [p.param_index for p in listed] == list(range(listed[0].param_count))
    assert all(len(p.param_id) <= 16 for p in listed)
    by_name = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))[0]
    assert by_name.param_type == mav.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", by_name.param_value)) == (4,)  # bytewise
    by_index = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"", by_name.param_index))[0]
    assert by_index.param_id == by_name.param_id
    for name, index in ((b"NO_SUCH_THING", -1), (b"", 9999)):
        (missing,) = rig.handle(mav.MAVLink_param_request_read_message(1, 1, name, index))
        assert (missing.get_type(), missing.error) == ("PARAM_ERROR", mav.MAV_PARAM_ERROR_DOES_NOT_EXIST)
        assert (missing.param_index, (missing.target_system, missing.target_component)) == (index, COMPANION)
    assert set_real(rig, "MIS_TAKEOFF_ALT", 0.8) == pytest.approx(0.8)
    assert rig.autopilot.parameters["MIS_TAKEOFF_ALT"] == pytest.approx(0.8)


@pytest.mark.parametrize("value", [NAN, math.inf, 0.0, 60.0])
def test_parameters_out_of_range_keep_their_value_and_say_so(value: float) -> None:
    rig = Rig()
    assert set_real(rig, "COM_OF_LOSS_T", value) == 0.5
    assert "COM_OF_LOSS_T" in rig.texts()[0]


def test_safety_parameters_are_fixed_while_armed_and_types_must_fit() -> None:
    rig = Rig()
    wrong_type = mav.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 1.0, mav.MAV_PARAM_TYPE_INT32)
    error, in_force = rig.handle(wrong_type)  # the error first: MAVSDK repeats a write it sees undone
    assert error.error == mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
    assert in_force.param_value == 0.5
    rig.command(400, 1.0)
    assert set_real(rig, "COM_OF_LOSS_T", 1.0) == 0.5
    assert set_real(rig, "MPC_LAND_SPEED", 0.2) == pytest.approx(0.2)


def test_small_protocols_answer() -> None:
    rig = Rig()
    rig.run(1.0)
    (sync,) = rig.handle(mav.MAVLink_timesync_message(0, 77))
    assert (sync.tc1, sync.ts1) == (1_000_000_000, 77)
    assert rig.handle(mav.MAVLink_timesync_message(5, 77)) == []
    (ping,) = rig.handle(mav.MAVLink_ping_message(1, 2, 0, 0))
    assert (ping.target_system, ping.target_component, ping.seq) == (*COMPANION, 2)
    (count,) = rig.handle(mav.MAVLink_mission_request_list_message(1, 1, 1))
    assert (count.count, count.mission_type) == (0, 1)
    (ack,) = rig.handle(mav.MAVLink_mission_count_message(1, 1, 3, 0))
    assert ack.type == mav.MAV_MISSION_UNSUPPORTED
    request = [7, 0, 3, 4, 0, *[0] * 246]
    (nak,) = rig.handle(mav.MAVLink_file_transfer_protocol_message(0, 1, 1, request))
    assert list(nak.payload[:6]) == [8, 0, 3, 129, 1, 4]
    assert nak.payload[12] == 1


def test_long_texts_travel_in_chunks() -> None:
    rig = Rig()
    text = "x" * 50 + "y" * 50
    rig.autopilot.flight.say(mav.MAV_SEVERITY_INFO, text)
    assert rig.texts() == [text]
    chunks = rig.seen(mav.MAVLINK_MSG_ID_STATUSTEXT)
    assert [c.chunk_seq for c in chunks] == [0, 1, 2]
    assert (
        b"".join(bytes(c.text, "ascii") if isinstance(c.text, str) else c.text for c in chunks)
        == text.encode()
    )


def test_everything_it_says_can_be_serialised() -> None:
    rig = Rig().offboard()
    rig.run(2.5, (0.1, -0.1, 0.0))
    link = mav.MAVLink(None, 1, 1)
    for id_ in (331, 49, 148):
        rig.telemetry += rig.handle(mav.MAVLink_command_long_message(1, 1, 512, 0, float(id_), *[NAN] * 6))
    for message in [*rig.telemetry, *rig.listed()]:
        (frame,) = split_frames(message.pack(link))
        assert decode(frame).get_msgId() == message.get_msgId()


def test_messages_from_itself_and_of_no_interest_do_nothing() -> None:
    rig = Rig()
    arm = mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, *[NAN] * 6)
    assert rig.handle(arm, (1, 1)) == []
    assert rig.handle(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) == []
    for number in range(300):  # its field is named like the message's number in pymavlink
        assert rig.handle(mav.MAVLink_statustext_message(6, b"hello", number)) == []
    assert not rig.vehicle.armed


def test_missions_and_logs_are_refused_at_once() -> None:
    rig = Rig()
    for type_, count in ((0, 0), (1, 0), (2, 0)):
        (ack,) = rig.handle(mav.MAVLink_mission_count_message(1, 1, count, type_))
        assert (ack.type, ack.mission_type) == (mav.MAV_MISSION_ACCEPTED, type_)
    for type_ in (0, 1, 2, 255):
        (ack,) = rig.handle(mav.MAVLink_mission_clear_all_message(1, 1, type_))
        assert (ack.type, ack.target_system, ack.target_component) == (0, *COMPANION)
    assert (
        rig.handle(mav.MAVLink_mission_request_list_message(1, 1, 7))[0].type == mav.MAV_MISSION_UNSUPPORTED
    )
    for wanted in (
        mav.MAVLink_mission_request_message(1, 1, 0),
        mav.MAVLink_mission_request_int_message(1, 1, 3),
    ):
        assert rig.handle(wanted)[0].type == mav.MAV_MISSION_INVALID_SEQUENCE
    item = mav.MAVLink_mission_item_int_message(1, 1, 0, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 0, 0, 1.0, 0)
    assert rig.handle(item)[0].type == mav.MAV_MISSION_UNSUPPORTED
    (entry,) = rig.handle(mav.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    assert entry.num_logs == 0


def test_other_set_points_and_origins_are_refused_with_a_reason() -> None:
    rig = Rig().offboard()
    rig.texts()
    zeros = [0.0, 0.0, 0.0]
    rig.handle(mav.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1.0, *zeros], *zeros, 0.5))
    rig.handle(
        mav.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0, 0, 0, *zeros, *zeros, 0.0, 0.0, 0.0)
    )
    (origin,) = rig.handle(mav.MAVLink_set_gps_global_origin_message(1, 0, 0, 0))
    assert (origin.latitude, origin.longitude) == (473977420, 85455940)
    assert [t.split(",")[0].split(":")[0] for t in rig.texts()] == [
        "Set-point dropped",
        "Set-point dropped",
        "Origin refused",
    ]


def test_old_stream_requests_do_not_starve_the_companion() -> None:
    rig = Rig()
    rig.run(0.1)
    for stream in range(13):
        assert rig.handle(mav.MAVLink_request_data_stream_message(1, 1, stream, 4, 1), (255, 0)) == []
        assert rig.handle(mav.MAVLink_request_data_stream_message(1, 0, stream, 0, 0), (255, 0)) == []
    rig.telemetry.clear()
    rig.run(1.0)
    assert len(rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)) == 100


def test_odometry_is_all_ned_and_motors_show_their_commands() -> None:
    rig = Rig(motor_commands=(0.0, 0.5, 1.0, 0.25))
    rig.vehicle.state.velocity_enu_m_s = (1.0, 2.0, 3.0)
    rig.run(0.01)
    odometry = rig.seen(mav.MAVLINK_MSG_ID_ODOMETRY)[0]
    assert (odometry.frame_id, odometry.child_frame_id, odometry.estimator_type) == (1, 1, 8)
    assert (odometry.vx, odometry.vy, odometry.vz) == (2.0, 1.0, -3.0)
    assert math.isnan(odometry.pose_covariance[0])
    servo = rig.seen(mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW)[0]
    assert [servo.servo1_raw, servo.servo2_raw, servo.servo3_raw, servo.servo4_raw] == [
        1000,
        1500,
        2000,
        1250,
    ]


def test_a_second_list_while_one_is_on_its_way_misses_nothing() -> None:
    rig = Rig()
    rig.handle(mav.MAVLink_param_request_list_message(1, 1))
    rig.run(0.01)
    rig.telemetry.clear()
    rig.handle(mav.MAVLink_param_request_list_message(1, 1), (255, 190))
    rig.run(0.5)
    values = rig.seen(mav.MAVLINK_MSG_ID_PARAM_VALUE)
    assert sorted(v.param_index for v in values) == list(range(values[0].param_count))
