"""What the commands of the simulated vehicle do."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from sim.autopilot.ground import degrees_e7, x_of, y_of
from tests.unit.autopilot.autopilot_fakes import NAN, RATE_HZ, Rig, set_int, set_real
from tests.unit.mavlink.server.served import as_int

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
NEAR = tuple(v / 1e7 for v in degrees_e7(1.0, 2.0))  # latitude, longitude
NAN7 = (NAN,) * 7
# Parameters worth trying for each command; every command of the table must be here.


def test_heights_above_home_and_above_the_sea() -> None:
    rig = Rig()
    assert rig.command(179, 0.0, NAN, NAN, NAN, *NEAR, 0.25) == ACCEPTED
    rig.command(400, 1.0)
    assert rig.handle(as_int(22, (*NAN7[:6], 0.5), frame=3))[0].result == ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(0.75, abs=0.03)
    assert rig.handle(as_int(192, (-1.0, 1.0, 0.0, NAN, NAN, NAN, 1.0), frame=0))[0].result == ACCEPTED
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(1.0, abs=0.03)


def test_home_moves_with_all_that_counts_from_it() -> None:
    rig = Rig()
    rig.run(0.5)
    assert rig.command(179, 0.0, NAN, NAN, NAN, *NEAR, 0.25) == ACCEPTED
    rig.run(0.02)
    home = rig.seen(mav.MAVLINK_MSG_ID_HOME_POSITION)[-1]  # at once
    assert (home.x, home.y, home.z) == pytest.approx((2.0, 1.0, -0.25), abs=0.01)
    assert home.altitude == pytest.approx(250, abs=1)
    rig.run(0.5)
    position = rig.seen(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)[-1]
    assert position.alt - position.relative_alt == 250
    assert rig.command(179, 1.0) == ACCEPTED
    assert rig.autopilot.flight.home_enu_m == rig.vehicle.state.position_enu_m
    rig.vehicle.state.valid = False
    assert rig.command(179, 1.0) == REJECTED


def test_geodesy_goes_there_and_back() -> None:
    latitude_e7, longitude_e7 = degrees_e7(12.34, -5.67)
    assert x_of(longitude_e7 / 1e7) == pytest.approx(12.34, abs=0.01)
    assert y_of(latitude_e7 / 1e7) == pytest.approx(-5.67, abs=0.01)


def test_return_climbs_flies_home_lands_and_disarms() -> None:
    rig = Rig().fly()
    assert rig.command(192, -1.0, 1.0, 0.0, NAN, *NEAR, 0.5) == ACCEPTED
    rig.run(12.0)
    x, y, _ = rig.vehicle.state.position_enu_m
    assert (x, y) == pytest.approx((1.0, 2.0), abs=0.5)  # single precision of COMMAND_LONG is 0.4 m
    assert rig.command(20) == ACCEPTED
    highest, states = 0.0, set()
    while rig.vehicle.armed:
        rig.run(0.1)
        highest = max(highest, rig.vehicle.state.position_enu_m[2])
        states.add(rig.autopilot.flight.landed_state)
        assert rig.now_s < 60.0
    assert highest == pytest.approx(1.0, abs=0.06)
    assert math.hypot(*rig.vehicle.state.position_enu_m[:2]) < 0.15
    assert rig.texts()[-3:] == ["Mode return", "Landed, disarmed", "Mode hold"]
    assert states == {1, 2, 4}
    assert 0x05040000 in [m.custom_mode for m in rig.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)]


def test_return_near_home_lands_there_and_waits_when_told_to() -> None:
    near = Rig().fly()
    assert near.command(20) == ACCEPTED
    near.run(0.5)
    assert near.autopilot.flight.landed_state == mav.MAV_LANDED_STATE_LANDING
    rig = Rig()
    set_real(rig, "RTL_MIN_DIST", 0.0)
    set_real(rig, "RTL_LAND_DELAY", 5.0)
    rig.fly().command(20)
    rig.run(6.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(1.0, abs=0.05)
    rig.run(6.0)
    assert not rig.vehicle.armed


def test_return_needs_an_armed_vehicle() -> None:
    rig = Rig()
    assert rig.command(20) == REJECTED
    assert rig.texts() == ["Mode return refused: not armed"]


def test_reposition_flies_there_with_heading_and_speed_and_pause_stops() -> None:
    rig = Rig().fly()
    assert rig.handle(as_int(192, (0.2, 1.0, 0.0, 0.0, *NEAR, 0.8)))[0].result == ACCEPTED
    fastest = 0.0
    for _ in range(200):
        rig.run(0.01)
        fastest = max(fastest, math.hypot(*rig.vehicle.state.velocity_enu_m_s[:2]))
    assert fastest == pytest.approx(0.2, abs=0.01)
    assert rig.vehicle.yaw_rad == pytest.approx(math.pi / 2)  # north
    assert rig.command(192, -1.0, 1.0, 0.0) == ACCEPTED  # QGroundControl's pause
    rig.run(3.0)
    x, y, _ = rig.vehicle.state.position_enu_m
    assert math.hypot(*rig.vehicle.state.velocity_enu_m_s[:2]) < 0.02
    assert math.hypot(x, y) < 1.0
    assert rig.handle(as_int(192, (-1.0, 1.0, 0.0, NAN, *NEAR, 0.8)))[0].result == ACCEPTED
    rig.run(15.0)
    assert rig.vehicle.state.position_enu_m == pytest.approx((1.0, 2.0, 0.8), abs=0.05)
    assert rig.mode is FlightMode.HOLD


def test_reposition_says_why_not() -> None:
    rig = Rig()
    assert rig.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, 1.0) == REJECTED
    rig.fly()
    assert rig.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, 30.0) == REJECTED
    assert rig.command(192, -1.0, 1.0, 0.0, NAN, 47.4, 8.6, 1.0) == REJECTED
    refusals = [t for t in rig.texts() if t.startswith("Reposition")]
    assert [r.split(" m ")[0].split(": ")[1][:2] for r in refusals] == ["no", "30", "41"]
    rig.vehicle.state.valid = False
    assert rig.command(192, -1.0, 1.0, 0.0, NAN, NAN, NAN, 1.0) == REJECTED


def test_take_off_never_descends() -> None:
    rig = Rig().fly(1.0)
    assert rig.command(22, *NAN7[:6], 0.3) == ACCEPTED
    assert "Already higher than the take-off height" in rig.texts()
    rig.run(2.0)
    assert rig.vehicle.state.position_enu_m[2] == pytest.approx(1.0, abs=0.05)
    assert rig.mode is FlightMode.HOLD


def test_reboot_unlocks_disarmed_and_is_denied_armed() -> None:
    rig = Rig(locked=True)
    rig.command(511, 32.0, 100_000.0)
    assert rig.command(400, 1.0) == REJECTED
    assert rig.command(246, 1.0) == ACCEPTED
    assert rig.vehicle.reboots == 1
    assert rig.autopilot.streams.interval_us(32) == round(1e6 / RATE_HZ)
    assert rig.command(400, 1.0) == ACCEPTED
    assert rig.command(246, 1.0) == DENIED
    assert rig.texts()[-1] == "Reboot refused: armed"
    assert rig.vehicle.armed


def test_failures_need_the_parameter_and_say_why_not() -> None:
    rig = Rig()
    assert rig.command(420, 101.0, 1.0, 2.0) == DENIED
    assert set_int(rig, "SYS_FAILURE_EN", 1) == 1
    assert rig.command(420, 101.0, 1.0, 2.0) == ACCEPTED
    assert rig.command(420, 100.0, 1.0) == ACCEPTED
    assert rig.vehicle.failures == {(101, 2): 1, (100, 0): 1}
    rig.vehicle.failure_refusal = "gyro: only motors fail"
    assert rig.command(420, 0.0, 1.0) == UNSUPPORTED
    texts = rig.texts()
    assert texts[1:] == [
        "Failure: system motor off 2",
        "Failure: system battery off",
        "Failure refused: gyro: only motors fail",
    ]


def test_prearm_checks_tell_all_problems() -> None:
    rig = Rig(locked=True, battery_v=3.0)
    rig.vehicle.state.valid = False
    assert rig.command(401) == ACCEPTED
    assert [t.split(":")[0] for t in rig.texts()] == ["Battery emergency, 0 %", *["Preflight fail"] * 3][1:]
