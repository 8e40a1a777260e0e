"""The simulated vehicle as ArduCopter: GUIDED, its take-off, its time-out, its numbers on the wire."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.ground import ORIGIN_WGS84
from sim.autopilot.profiles import ARDUPILOT, PROFILES, PX4
from tests.unit.autopilot.autopilot_fakes import COMPANION, NAN, FakeVehicle, Rig, setpoint

ACCEPTED, FAILED, DENIED = mav.MAV_RESULT_ACCEPTED, mav.MAV_RESULT_FAILED, mav.MAV_RESULT_DENIED
GUIDED, LAND_MODE, BRAKE, RTL = 4.0, 9.0, 17.0, 6.0
TAKE_OFF = 22


def origin(latitude_deg: float = ORIGIN_WGS84[0]):
    place = (round(latitude_deg * 1e7), round(ORIGIN_WGS84[1] * 1e7))
    return mav.MAVLink_set_gps_global_origin_message(1, *place, 0)


def grounded() -> Rig:
    rig = Rig(ARDUPILOT)
    rig.handle(origin())
    return rig


def guided() -> Rig:
    rig = grounded()
    assert rig.command(176, 1.0, GUIDED) == ACCEPTED
    assert rig.command(400, 1.0) == ACCEPTED
    return rig


def flying(height_m: float = 0.5) -> Rig:
    rig = guided()
    assert rig.command(TAKE_OFF, *[0.0] * 6, height_m) == ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(height_m, abs=0.06)
    return rig


def beat(rig: Rig):
    rig.run(0.02)
    rig.run(1.0)
    return rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1]


def parameter(rig: Rig, name: str):
    (value,) = rig.handle(mav.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    return value


def set_parameter(rig: Rig, name: str, value: float, type_: int):
    return rig.handle(mav.MAVLink_param_set_message(1, 1, name.encode(), value, type_))


def test_heartbeat_is_ardupilots_and_alone_comes_unasked() -> None:
    rig = grounded()
    rig.run(3.0)
    (first, *_) = rig.telemetry
    assert (first.autopilot, first.type, first.custom_mode) == (3, 2, 17)
    assert {m.get_type() for m in rig.telemetry} <= {"HEARTBEAT", "STATUSTEXT"}
    rig.command(176, 1.0, GUIDED)
    shown = beat(rig)
    assert (shown.custom_mode, shown.base_mode & 8) == (4, 8)


def test_streams_come_as_asked_by_interval_or_by_group() -> None:
    rig = grounded()
    assert rig.command(511, 32.0, 20_000.0) == ACCEPTED
    rig.handle(mav.MAVLink_request_data_stream_message(1, 1, 10, 25, 1))  # EXTRA1
    rig.run(2.0)
    assert len(rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)) == pytest.approx(100, abs=2)
    assert len(rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)) == pytest.approx(50, abs=2)
    rig.telemetry.clear()
    rig.handle(mav.MAVLink_request_data_stream_message(1, 1, 10, 2, 1))  # never takes anything away
    rig.run(1.0)
    assert len(rig.seen(mav.MAVLINK_MSG_ID_ATTITUDE)) == pytest.approx(25, abs=2)


def test_all_groups_at_once_as_mavproxy_asks_for_them() -> None:
    rig = grounded()
    rig.handle(mav.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    rig.run(2.0)
    for message_id in (mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mav.MAVLINK_MSG_ID_SYS_STATUS):
        assert len(rig.seen(message_id)) == pytest.approx(8, abs=1)


def test_px4_ignores_data_streams() -> None:
    rig = Rig()
    assert mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM not in rig.autopilot.handled
    assert mav.MAVLINK_MSG_ID_REQUEST_DATA_STREAM in Rig(ARDUPILOT).autopilot.handled


def test_no_position_before_the_origin_is_told() -> None:
    rig = Rig(ARDUPILOT)
    rig.command(511, 32.0, 10_000.0)
    rig.command(511, 1.0, 100_000.0)
    rig.command(176, 1.0, GUIDED)
    rig.run(1.0)
    assert not rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
    assert not rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1].onboard_control_sensors_health & 0x10000000
    assert rig.command(400, 1.0) == FAILED
    assert any("no position estimate" in text for text in rig.texts())
    assert rig.handle(origin(ORIGIN_WGS84[0] + 1.0)) == []
    assert any("room lies at" in text for text in rig.texts())
    (told,) = rig.handle(origin())
    assert told.get_type() == "GPS_GLOBAL_ORIGIN"
    rig.run(1.0)
    assert len(rig.seen(mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED)) == 100
    assert rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1].onboard_control_sensors_health & 0x10000000
    assert rig.command(400, 1.0) == ACCEPTED


def test_a_vehicle_found_in_the_air_has_its_origin() -> None:
    vehicle = FakeVehicle(armed=True, on_ground=False)
    vehicle.state.position_enu_m = (0.0, 0.0, 1.0)
    rig = Rig(ARDUPILOT, armed=True, on_ground=False, state=vehicle.state)
    assert rig.autopilot.flight.positioned


def test_arming_needs_guided() -> None:
    rig = grounded()
    assert rig.command(400, 1.0) == FAILED
    rig.command(176, 1.0, LAND_MODE)
    assert rig.command(400, 1.0) == FAILED
    rig.command(176, 1.0, GUIDED)
    assert rig.command(400, 1.0) == ACCEPTED
    assert rig.command(400, 1.0) == ACCEPTED  # armed already


def test_modes_are_numbers_and_those_of_sticks_fail() -> None:
    rig = grounded()
    for number in (0.0, 5.0, 99.0):
        assert rig.command(176, 1.0, number) == FAILED
    assert any("LOITER: no stick input" in text for text in rig.texts())
    for number, mode in (
        (BRAKE, FlightMode.HOLD),
        (LAND_MODE, FlightMode.LAND),
        (GUIDED, FlightMode.OFFBOARD),
    ):
        assert rig.command(176, 1.0, number) == ACCEPTED
        assert rig.mode is mode


def test_take_off_needs_guided_arming_the_ground_and_a_height() -> None:
    rig = grounded()
    height = (0.0,) * 6 + (0.5,)
    assert rig.command(TAKE_OFF, *height) == FAILED  # BRAKE
    rig.command(176, 1.0, GUIDED)
    assert rig.command(TAKE_OFF, *height) == FAILED  # not armed
    rig.command(400, 1.0)
    assert rig.command(TAKE_OFF) == FAILED  # no height
    assert rig.command(TAKE_OFF, *height) == ACCEPTED
    assert rig.command(TAKE_OFF, *height) == ACCEPTED  # the same again
    rig.run(6.0)
    assert rig.command(TAKE_OFF, *height) == FAILED  # in the air
    shown = beat(rig)
    assert shown.custom_mode == 4  # take-off and its end are both GUIDED


def test_take_off_counts_from_home_and_stays_in_guided() -> None:
    rig = grounded()
    rig.autopilot.flight.pilot.home_enu_m = (0.0, 0.0, -0.3)
    rig.command(176, 1.0, GUIDED)
    rig.command(400, 1.0)
    assert rig.command(TAKE_OFF, *[0.0] * 6, 1.0) == ACCEPTED
    rig.command(511, 245.0, 10_000.0)
    rig.run(1.0)
    assert rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)[-1].landed_state == mav.MAV_LANDED_STATE_TAKEOFF
    rig.run(8.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.7, abs=0.06)
    assert rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)[-1].landed_state == mav.MAV_LANDED_STATE_IN_AIR


def test_a_height_above_sea_level_is_denied() -> None:
    rig = guided()
    message = mav.MAVLink_command_int_message(1, 1, 0, TAKE_OFF, 0, 0, 0, 0, 0, 0, 0, 0, 0.5)
    (ack,) = rig.handle(message)
    assert ack.result == DENIED


def test_a_velocity_set_point_ends_the_take_off_for_good() -> None:
    rig = guided()
    assert rig.command(TAKE_OFF, *[0.0] * 6, 0.5) == ACCEPTED
    rig.run(5.0, (0.0, 0.0, 0.0))  # zeros streamed from the start: it never lifts
    assert rig.vehicle.on_ground
    rig.run(2.0, (0.0, 0.0, -0.5))  # nor does it follow set-points upwards from the ground
    assert rig.vehicle.on_ground
    assert rig.mode is FlightMode.OFFBOARD


def test_set_points_are_flown_and_after_the_time_out_it_stands_still_without_a_word() -> None:
    rig = flying()
    assert parameter(rig, "GUID_TIMEOUT").param_value == pytest.approx(3.0)
    rig.run(1.0, (0.5, 0.0, 0.0))
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.5, 0.0))
    rig.texts()
    rig.run(2.9)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.5, 0.0))
    before = rig.vehicle.setpoints
    rig.run(0.3)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, 0.0))
    rig.run(5.0)
    assert rig.vehicle.setpoints > before + 500  # told on and on: silence would lock the firmware
    assert (rig.mode, rig.vehicle.armed, rig.autopilot.flight.failsafe) == (FlightMode.OFFBOARD, True, False)
    assert rig.texts() == []
    rig.run(0.1, (0.5, 0.0, 0.0))  # and goes on when the stream does
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.5, 0.0))


def test_set_points_outside_guided_are_ignored_without_a_word() -> None:
    rig = flying()
    rig.command(176, 1.0, BRAKE)
    rig.texts()
    rig.run(1.0, (0.5, 0.0, 0.0))
    assert rig.mode is FlightMode.HOLD
    assert rig.texts() == []
    assert math.hypot(*rig.vehicle.state.velocity_enu_m_s[:2]) < 0.05
    rig.command(176, 1.0, GUIDED)
    rig.run(0.5)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, 0.0))  # not what was said before


@pytest.mark.parametrize("wrong", [setpoint(0.5, frame=12), setpoint(NAN), setpoint(0.5, mask=0xFFFF)])
def test_a_wrong_set_point_stops_it(wrong) -> None:
    rig = flying()
    rig.run(1.0, (0.5, 0.0, 0.0))
    rig.handle(wrong)
    rig.run(0.05)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, 0.0))


def test_offset_frames_are_known() -> None:
    rig = flying()
    for frame, expected in ((7, (0.0, 0.5, 0.0)), (9, (0.5, 0.0, 0.0))):  # its nose is to the east
        rig.handle(setpoint(0.5, frame=frame))
        rig.run(0.02)
        assert rig.vehicle.setpoint == pytest.approx(expected, abs=1e-6)


def test_landing_and_forced_disarming() -> None:
    rig = flying()
    assert rig.command(400, 0.0) == FAILED
    assert rig.command(21) == ACCEPTED
    assert rig.mode is FlightMode.LAND
    rig.run(6.0)
    assert not rig.vehicle.armed
    assert rig.mode is FlightMode.LAND  # stays, and must be left before the next arming
    assert rig.command(400, 1.0) == FAILED
    again = flying()
    assert again.command(400, 0.0, 21196.0) == ACCEPTED
    assert not again.vehicle.armed


def test_parameters_have_ardupilots_names_units_and_encoding() -> None:
    rig = grounded()
    delay = parameter(rig, "DISARM_DELAY")
    assert (delay.param_value, delay.param_type) == (10.0, mav.MAV_PARAM_TYPE_INT8)
    assert parameter(rig, "WPNAV_SPEED").param_value == pytest.approx(500.0)
    assert rig.autopilot.parameters["MPC_XY_VEL_MAX"] == pytest.approx(5.0)
    (value,) = set_parameter(rig, "WPNAV_SPEED", 120.0, mav.MAV_PARAM_TYPE_REAL32)
    assert value.param_value == pytest.approx(120.0)
    assert rig.autopilot.parameters["MPC_XY_VEL_MAX"] == pytest.approx(1.2)
    set_parameter(rig, "DISARM_DELAY", 20.0, mav.MAV_PARAM_TYPE_INT8)
    assert rig.autopilot.parameters["COM_DISARM_PRFLT"] == rig.autopilot.parameters["COM_DISARM_LAND"] == 20.0
    (value,) = set_parameter(rig, "FS_GCS_ENABLE", 5.0, mav.MAV_PARAM_TYPE_INT8)
    assert (value.param_value, rig.autopilot.parameters["NAV_DLL_ACT"]) == (5.0, 3)
    (value,) = set_parameter(rig, "DISARM_DELAY", 29.995, mav.MAV_PARAM_TYPE_REAL32)  # MAVProxy: all are real
    assert (value.param_value, value.param_type) == (30.0, mav.MAV_PARAM_TYPE_INT8)
    error, value = set_parameter(rig, "FS_GCS_ENABLE", 2.0, mav.MAV_PARAM_TYPE_INT8)
    assert (error.get_type(), value.param_value) == ("PARAM_ERROR", 5.0)
    (error,) = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"COM_OF_LOSS_T", -1))
    assert error.get_type() == "PARAM_ERROR"
    capabilities = rig.handle(command_long(512, 148.0))[1].capabilities
    assert not capabilities & mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE


def command_long(number: int, *params: float):
    return mav.MAVLink_command_long_message(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))


def test_every_parameter_of_a_profile_stands_for_ones_that_exist() -> None:
    own = PX4.new_parameters(1)
    for who in PROFILES.values():
        values = who.new_parameters(1)
        for row in who.parameters(1):
            if row.stands_for:
                assert all(own.entry(name) for name in row.names)
            assert row.outside(values[row.names[0]]) == pytest.approx(row.default)
        for name, value in who.set_before_flight.items():
            values.preset(name, value)


def test_the_station_is_who_has_the_id_of_sysid_mygcs_and_its_silence_lands() -> None:
    companion_beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, 4, 3)
    station_beat = mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    for mine, mode in ((COMPANION[0], FlightMode.LAND), (255, FlightMode.OFFBOARD)):
        rig = grounded()
        set_parameter(rig, "FS_GCS_ENABLE", 5.0, mav.MAV_PARAM_TYPE_INT8)
        set_parameter(rig, "SYSID_MYGCS", float(mine), mav.MAV_PARAM_TYPE_INT16)
        rig.command(176, 1.0, GUIDED)
        rig.command(400, 1.0)
        rig.command(TAKE_OFF, *[0.0] * 6, 0.5)
        for _ in range(60):
            rig.handle(companion_beat, COMPANION)
            rig.run(0.1)
        rig.run(0.1, (0.0, 0.0, 0.0), COMPANION)
        assert rig.mode is FlightMode.OFFBOARD
        for _ in range(52):  # a ground station that is heard does not make up for the companion
            if mine == COMPANION[0]:
                rig.handle(station_beat, (255, 190))
            rig.run(0.1)
        assert rig.mode is mode


def test_presets_that_cannot_be_are_refused_with_what_can() -> None:
    values = ARDUPILOT.new_parameters(1)
    values.preset("GUID_TIMEOUT", 0.5)
    assert values["COM_OF_LOSS_T"] == 0.5
    for name, value, words in (
        ("GUID_TIME", 1.0, "not known: allowed is .*GUID_TIMEOUT"),
        ("GUID_TIMEOUT", 99.0, "found 99, allowed is 0.1 to 5"),
        ("DISARM_DELAY", 1.5, "found 1.5"),
        ("SYSID_ENFORCE", 1.0, "allowed is 0"),
    ):
        with pytest.raises(ValueError, match=words):
            values.preset(name, value)


def test_idle_on_the_ground_it_disarms_whatever_is_streamed() -> None:
    rig = guided()
    rig.run(9.9, (0.0, 0.0, 0.0), COMPANION)
    assert rig.vehicle.armed
    rig.run(0.3, (0.0, 0.0, 0.0), COMPANION)
    assert not rig.vehicle.armed
