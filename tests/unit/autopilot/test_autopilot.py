"""The autopilot without sockets or clocks: arming, modes, refusals, its own flying."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.autopilot import Autopilot
from tests.unit.autopilot.autopilot_fakes import (
    HOLD,
    NAN,
    OFFBOARD,
    RATE_HZ,
    FakeVehicle,
    Rig,
)


def test_no_estimate_clears_health_and_refuses_arming_and_take_off() -> None:
    rig = Rig()
    rig.vehicle.state.valid = False
    rig.run(0.3)
    status = rig.seen(mav.MAVLINK_MSG_ID_SYS_STATUS)[-1]
    assert not status.onboard_control_sensors_health & (32 | mav.MAV_SYS_STATUS_PREARM_CHECK)
    assert rig.command(400, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.command(22) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts() == ["Arming refused: no position estimate", "Take-off refused: no position estimate"]
    assert not rig.vehicle.armed


def test_firmware_refusal_is_passed_on_with_its_reason() -> None:
    rig = Rig(arm_refusal="battery low")
    assert rig.command(400, 1.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts() == ["Arming refused: battery low"]
    assert len(rig.seen(mav.MAVLINK_MSG_ID_STATUSTEXT)) == 1


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
    assert rig.command(22) == mav.MAV_RESULT_ACCEPTED  # QGroundControl arms after this
    assert rig.mode is FlightMode.TAKEOFF
    assert rig.vehicle.setpoints == 0
    assert rig.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize("height_m", [0.0, -1.0, 0.05, 20.5])
def test_take_off_heights_out_of_range_are_refused(height_m: float) -> None:
    rig = Rig()
    rig.command(400, 1.0)
    assert rig.command(22, *[NAN] * 6, height_m) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert "Take-off refused" in rig.texts()[-1]


def test_repeated_commands_are_accepted_and_change_nothing() -> None:
    rig = Rig()
    assert rig.command(400, 0.0) == mav.MAV_RESULT_ACCEPTED  # disarmed already
    for _ in range(3):
        assert rig.command(400, 1.0) == mav.MAV_RESULT_ACCEPTED
    for _ in range(3):
        assert rig.command(22, *[NAN] * 6, 0.5) == mav.MAV_RESULT_ACCEPTED
        rig.run(0.2)
    assert rig.texts() == ["Armed", "Mode take-off"]
    rig.run(5.0)
    rig.run(0.1, (0.0, 0.0, 0.0))
    for _ in range(3):
        assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
    for _ in range(3):
        assert rig.command(21) == mav.MAV_RESULT_ACCEPTED
    assert rig.texts() == ["Mode hold", "Mode offboard", "Mode land"]


def test_forced_arming_does_not_skip_the_checks() -> None:
    rig = Rig()
    rig.vehicle.state.valid = False
    assert rig.command(400, 1.0, 21196.0) == mav.MAV_RESULT_TEMPORARILY_REJECTED


def test_termination_only_when_armed() -> None:
    rig = Rig()
    assert rig.command(185, 1.0) == mav.MAV_RESULT_DENIED
    rig.fly()
    assert rig.command(185, 0.0) == mav.MAV_RESULT_DENIED
    assert rig.vehicle.armed
    assert rig.command(185, 1.0) == mav.MAV_RESULT_ACCEPTED
    assert not rig.vehicle.armed


def test_landing_waits_for_lasting_contact_and_works_on_the_pad() -> None:
    rig = Rig().fly()
    rig.command(21)
    rig.run(0.5)
    rig.vehicle.on_pad = True  # a bounce
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


def test_lost_estimate_in_flight_lands_without_a_position() -> None:
    rig = Rig().fly()
    rig.vehicle.state.valid = False
    rig.run(0.45)
    assert rig.mode is FlightMode.HOLD
    rig.run(1.0)
    assert rig.mode is FlightMode.LAND
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, -0.3), abs=0.02)
    assert "No position estimate: landing" in rig.texts()


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
    assert rig.mode is FlightMode.OFFBOARD  # until its stream ends
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
