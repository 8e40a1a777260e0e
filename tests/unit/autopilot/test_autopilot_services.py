"""Telemetry and parameters of the simulated vehicle."""

from __future__ import annotations

import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import PX4_CODES, FlightMode
from tests.unit.autopilot.autopilot_fakes import (
    FEET_M,
    NAN,
    Rig,
    set_real,
)


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


def test_parameters_can_be_listed_read_and_set() -> None:
    rig = Rig()
    assert len(rig.listed()) == len(rig.autopilot.parameters)
    by_name = rig.handle(mav.MAVLink_param_request_read_message(1, 1, b"COM_OBL_RC_ACT", -1))[0]
    assert by_name.param_type == mav.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", by_name.param_value)) == (4,)  # bytewise
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


def test_another_origin_is_refused_with_a_reason() -> None:
    rig = Rig().offboard()
    rig.texts()
    (origin,) = rig.handle(mav.MAVLink_set_gps_global_origin_message(1, 0, 0, 0))
    assert (origin.latitude, origin.longitude) == (473977420, 85455940)
    assert rig.texts() == ["Origin refused: the simulated room does not move"]


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
