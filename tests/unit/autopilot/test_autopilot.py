"""Tests the simulated autopilot without sockets or clocks: arming, modes, set-points, telemetry, settings."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.autopilot import Autopilot
from tests.unit.autopilot.autopilot_fakes import RATE_HZ, FakeVehicle, Rig, set_real
from tests.unit.mavlink.server.served import HOLD, NAN, setpoint


def test_no_estimate_clears_health_and_refuses_arming_and_take_off() -> None:
    rig = Rig()
    rig.vehicle.state.valid = False
    rig.run(0.3)
    status = rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1]
    assert not status.onboard_control_sensors_health & (32 | mav.MAV_SYS_STATUS_PREARM_CHECK)
    assert rig.command(400, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.command(22) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts() == ["Arming refused: no position estimate", "Take-off refused: no position estimate"]
    assert rig.command(400, 1.0, 21196.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED  # 21196 forces arming
    assert not rig.vehicle.armed


def test_take_off_climbs_at_half_a_metre_a_second_at_most_and_holds() -> None:
    rig = Rig()
    rig.command(400, 1.0)
    rig.command(22, *[NAN] * 6, 1.0)
    fastest = 0.0
    for _ in range(800):
        rig.run(0.01)
        fastest = max(fastest, rig.vehicle.state.velocity_enu_m_s[2])
    assert 0.4 < fastest <= 0.5 + 1e-9
    assert rig.mode is FlightMode.HOLD
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(1.0, abs=0.03)


def test_take_off_without_a_height_takes_the_parameter_and_order_does_not_matter() -> None:
    rig = Rig()
    assert rig.command(22) == mav.MAV_RESULT_ACCEPTED  # QGroundControl arms after this reply
    assert rig.mode is FlightMode.TAKEOFF
    assert rig.vehicle.setpoints == 0
    assert rig.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.5, abs=0.03)


def test_landing_waits_for_lasting_contact_and_works_on_the_pad() -> None:
    rig = Rig().fly()
    rig.command(21)
    rig.run(0.5)
    rig.vehicle.on_pad = True  # the vehicle bounces on the pad
    rig.run(0.2)
    rig.vehicle.on_pad = False
    rig.run(0.05)
    assert rig.vehicle.armed
    rig.vehicle.on_pad = True
    rig.run(0.29)
    assert rig.vehicle.armed
    rig.run(0.03)
    assert not rig.vehicle.armed


def test_landed_state_follows_mode_and_contact() -> None:
    rig = Rig()
    rig.run(0.1)
    states = [rig.autopilot.flight.landed_state]
    rig.command(400, 1.0)
    rig.command(22)
    rig.run(1.0)
    states.append(rig.autopilot.flight.landed_state)
    rig.run(5.0)
    states.append(rig.autopilot.flight.landed_state)
    rig.command(21)
    rig.run(0.5)
    states.append(rig.autopilot.flight.landed_state)
    rig.run(4.0)
    states.append(rig.autopilot.flight.landed_state)
    assert states == [1, 3, 2, 4, 1]
    shown = [m.landed_state for m in rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)]
    assert [s for i, s in enumerate(shown) if i == 0 or shown[i - 1] != s] == states


def test_disarms_itself_when_nothing_happens_and_after_landing_in_offboard() -> None:
    rig = Rig()
    rig.command(400, 1.0)
    rig.run(9.9)
    assert rig.vehicle.armed
    rig.run(0.2)
    assert not rig.vehicle.armed
    assert "Disarmed: no take-off" in rig.texts()
    rig.offboard()
    rig.run(3.5, (0.0, 0.0, 0.3))
    assert rig.vehicle.armed
    rig.run(1.5, (0.0, 0.0, 0.3))
    assert not rig.vehicle.armed
    assert rig.mode is FlightMode.OFFBOARD  # the mode lasts until the set-points end
    rig.run(0.6)
    assert rig.mode is FlightMode.HOLD


def test_firmware_that_disarms_is_noticed() -> None:
    rig = Rig().fly()
    rig.vehicle.armed = False
    rig.run(0.02)
    assert "Disarmed by the firmware" in rig.texts()
    assert not rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1].base_mode & 128


def test_vehicle_that_starts_in_the_air_is_held_there() -> None:
    vehicle = FakeVehicle(armed=True, on_ground=False)
    vehicle.state.position_enu_m = (1.0, 2.0, 1.5)
    rig = Rig()
    rig.vehicle, rig.autopilot = vehicle, Autopilot(vehicle, RATE_HZ)
    rig.run(3.0)
    assert vehicle.state.position_enu_m == pytest.approx((1.0, 2.0, 1.5), abs=0.02)
    assert rig.seen(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)[0].landed_state == 2
    assert rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[0].base_mode == 157


def test_hold_takes_over_a_moving_vehicle_without_a_step() -> None:
    rig = Rig().offboard()
    rig.run(2.0, (0.4, 0.0, 0.0))
    assert rig.command(176, *HOLD) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.4, 0.0), abs=0.02)
    rig.run(8.0)
    assert math.hypot(*rig.vehicle.state.velocity_enu_m_s) < 0.02


def test_offboard_hands_on_each_set_point_once_in_enu() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    before = rig.vehicle.setpoints
    rig.handle(setpoint(0.1, 0.2, -0.3, yaw=0.0))
    rig.run(0.05)
    assert rig.vehicle.setpoints == before + 1
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.1, 0.3))
    assert rig.vehicle.yaw_rad == pytest.approx(math.pi / 2)  # the nose points north


def test_yaw_rate_is_integrated_and_no_yaw_holds_the_heading() -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(mask=3527))
    rig.run(0.02)
    assert rig.vehicle.yaw_rad == pytest.approx(0.0)
    for _ in range(100):
        rig.handle(setpoint(mask=1479, rate=0.5))
        rig.run(0.01)
    assert rig.vehicle.yaw_rad == pytest.approx(-0.5, abs=0.01)  # NED: a positive yaw rate turns clockwise


def test_stream_that_comes_back_does_not_take_over_by_itself() -> None:
    rig = Rig().offboard()
    rig.run(0.6)
    assert rig.mode is FlightMode.LAND
    rig.run(0.3, (0.0, 0.0, -1.0))
    assert rig.mode is FlightMode.LAND
    assert rig.vehicle.setpoint[2] < 0.0


def test_safety_parameters_are_fixed_while_armed_and_types_must_fit() -> None:
    rig = Rig()
    wrong_type = mav.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 1.0, mav.MAV_PARAM_TYPE_INT32)
    error, in_force = rig.handle(wrong_type)  # without an error reply, MAVSDK repeats the write
    assert error.error == mav.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
    assert in_force.param_value == 0.5
    rig.command(400, 1.0)
    assert set_real(rig, "COM_OF_LOSS_T", 1.0) == 0.5
    assert set_real(rig, "MPC_LAND_SPEED", 0.2) == pytest.approx(0.2)


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
