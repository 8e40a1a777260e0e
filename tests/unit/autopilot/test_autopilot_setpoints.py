"""Set-points: what is accepted, from whom, and what happens when they stop."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from tests.unit.autopilot.autopilot_fakes import (
    FEET_M,
    GROUND_STATION,
    NAN,
    OFFBOARD,
    Rig,
    set_real,
    setpoint,
)


def test_offboard_needs_a_living_stream() -> None:
    rig = Rig().fly()
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.texts()[-1] == "Mode offboard refused: no set-points"
    rig.run(0.1, (1.0, 0.0, 0.0))
    assert rig.vehicle.setpoint is not None
    assert math.hypot(*rig.vehicle.setpoint[:2]) < 0.05  # streaming alone moves nothing
    rig.run(0.6)
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_TEMPORARILY_REJECTED
    rig.run(0.1, (0.0, 0.0, 0.0))
    assert rig.command(176, *OFFBOARD) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.02)
    beat = rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1]
    assert (beat.base_mode, beat.custom_mode) == (145, 393216)


def test_offboard_hands_on_each_set_point_once_in_enu() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    before = rig.vehicle.setpoints
    rig.handle(setpoint(0.1, 0.2, -0.3, yaw=0.0))
    rig.run(0.05)
    assert rig.vehicle.setpoints == before + 1
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.1, 0.3))
    assert rig.vehicle.yaw_rad == pytest.approx(math.pi / 2)  # nose to the north


def test_body_frame_is_turned_by_the_heading_only() -> None:
    rig = Rig().offboard()
    rig.vehicle.state.quaternion = (math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4))  # nose north
    rig.handle(setpoint(1.0, 0.5, 0.25, frame=8))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.5, 1.0, -0.25))


def test_yaw_rate_is_integrated_and_no_yaw_holds_the_heading() -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(mask=3527))
    rig.run(0.02)
    assert rig.vehicle.yaw_rad == pytest.approx(0.0)
    for _ in range(100):
        rig.handle(setpoint(mask=1479, rate=0.5))
        rig.run(0.01)
    assert rig.vehicle.yaw_rad == pytest.approx(-0.5, abs=0.01)  # clockwise in NED


@pytest.mark.parametrize(
    "bad",
    [
        setpoint(NAN),
        setpoint(0.0, math.inf),
        setpoint(0.0, 0.0, 5.01),
        setpoint(4.0, 4.0),
        setpoint(mask=0),
        setpoint(mask=2552),  # position
        setpoint(mask=2503 | 8),  # only two of three axes
        setpoint(mask=2503 & ~64),  # with acceleration
        setpoint(frame=7),
        setpoint(frame=9),
        setpoint(frame=12),
        setpoint(yaw=NAN),
        setpoint(mask=1479, rate=NAN),
        setpoint(mask=1479, rate=100.0),
    ],
)
def test_bad_set_points_are_dropped_with_one_text_and_keep_no_stream_alive(bad) -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(0.1))
    rig.run(0.01)
    rig.texts()
    good = rig.vehicle.setpoint
    for _ in range(45):
        rig.handle(bad)
        rig.run(0.01)
        assert rig.vehicle.setpoint == good
    assert len([t for t in rig.texts() if t.startswith("Set-point dropped")]) == 1
    rig.handle(bad)
    rig.run(0.1)
    assert rig.mode is FlightMode.LAND


@pytest.mark.parametrize("mask", [2503, 1479, 3527, 4039])
def test_masks_that_clients_use_are_taken(mask: int) -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(0.1, mask=mask))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.1, 0.0))


def test_set_points_for_another_vehicle_are_ignored() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    rig.handle(setpoint(1.0, target=(2, 1)))
    rig.run(0.01)
    assert rig.vehicle.setpoint == pytest.approx((0.0, 0.0, 0.0))


def test_one_sender_has_control_until_it_falls_silent() -> None:
    rig = Rig().offboard()
    rig.texts()
    for _ in range(20):
        rig.handle(setpoint(0.1))
        rig.handle(setpoint(0.0, 1.0), GROUND_STATION)
        rig.run(0.01)
        assert rig.vehicle.setpoint == pytest.approx((0.0, 0.1, 0.0))
    assert rig.texts() == ["Set-point dropped: 1/191 has control"]
    rig.run(0.45)
    assert rig.mode is FlightMode.OFFBOARD  # not lost yet, but the intruder is still refused
    rig.handle(setpoint(0.0, 1.0), GROUND_STATION)
    rig.run(0.2)
    assert rig.mode is FlightMode.LAND
    rig.run(0.1, (0.0, 0.2, 0.0), GROUND_STATION)
    assert rig.command(176, *OFFBOARD, sender=GROUND_STATION) == mav.MAV_RESULT_ACCEPTED
    rig.run(0.1, (0.0, 0.2, 0.0), GROUND_STATION)
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.0, 0.0))


def test_anyone_may_land_the_vehicle() -> None:
    rig = Rig().offboard()
    assert rig.command(21, sender=GROUND_STATION) == mav.MAV_RESULT_ACCEPTED
    assert rig.mode is FlightMode.LAND


@pytest.mark.parametrize("limit_s", [0.5, 0.3])
def test_loss_of_set_points_lands_and_disarms_in_simulated_time(limit_s: float) -> None:
    rig = Rig()
    set_real(rig, "COM_OF_LOSS_T", limit_s)
    rig.offboard()
    rig.run(1.0, (0.2, 0.0, 0.0))
    lost_s = rig.now_s - 0.01
    while rig.mode is FlightMode.OFFBOARD:
        rig.run(0.01)
    assert rig.now_s - 0.01 - lost_s == pytest.approx(limit_s + 0.01, abs=0.005)
    assert f"No set-points for {limit_s:g} s: landing" in rig.texts()
    assert rig.autopilot.flight.failsafe
    slowest = 0.0
    while rig.vehicle.armed:
        rig.run(0.01)
        slowest = min(slowest, rig.vehicle.state.velocity_enu_m_s[2])
        assert rig.now_s < lost_s + 6.0
    assert slowest == pytest.approx(-0.3, abs=0.02)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(FEET_M)
    assert rig.texts()[-2:] == ["Landed, disarmed", "Mode hold"]
    beats = [b.system_status for b in rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)]
    assert mav.MAV_STATE_CRITICAL in beats
    assert beats[-1] == mav.MAV_STATE_STANDBY


def test_stream_that_comes_back_does_not_take_over_by_itself() -> None:
    rig = Rig().offboard()
    rig.run(0.6)
    assert rig.mode is FlightMode.LAND
    rig.run(0.3, (0.0, 0.0, -1.0))
    assert rig.mode is FlightMode.LAND
    assert rig.vehicle.setpoint[2] < 0.0
