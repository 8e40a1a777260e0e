"""What the simulated vehicle does with set-points, and without them."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from tests.unit.autopilot.autopilot_fakes import (
    FEET_M,
    Rig,
    set_real,
    setpoint,
)


def test_offboard_hands_on_each_set_point_once_in_enu() -> None:
    rig = Rig().offboard()
    rig.run(0.01)
    before = rig.vehicle.setpoints
    rig.handle(setpoint(0.1, 0.2, -0.3, yaw=0.0))
    rig.run(0.05)
    assert rig.vehicle.setpoints == before + 1
    assert rig.vehicle.setpoint == pytest.approx((0.2, 0.1, 0.3))
    assert rig.vehicle.yaw_rad == pytest.approx(math.pi / 2)  # nose to the north


def test_yaw_rate_is_integrated_and_no_yaw_holds_the_heading() -> None:
    rig = Rig().offboard()
    rig.handle(setpoint(mask=3527))
    rig.run(0.02)
    assert rig.vehicle.yaw_rad == pytest.approx(0.0)
    for _ in range(100):
        rig.handle(setpoint(mask=1479, rate=0.5))
        rig.run(0.01)
    assert rig.vehicle.yaw_rad == pytest.approx(-0.5, abs=0.01)  # clockwise in NED


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
