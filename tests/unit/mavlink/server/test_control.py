"""Tests which set-points are accepted, and which requests of other senders during a flight by set-points."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.commander import Right, read_setpoint
from bridge.mavlink.server.profile import FlightMode
from tests.unit.mavlink.server.served import (
    ACCEPTED,
    GROUND_STATION,
    HOLD,
    KILL,
    LAND,
    MAVSDK,
    NAN,
    OFFBOARD,
    REJECTED,
    STRANGER,
    setpoint,
)

FOR_OWNER_ONLY = {
    400: [(0.0, 0.0), (1.0, 0.0)],
    176: [HOLD, OFFBOARD],
    22: [(*[NAN] * 6, 1.0)],
    20: [()],
    192: [(-1.0, 1.0)],
    246: [(1.0,)],
    420: [(101.0, 1.0)],
}


@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
def test_others_cannot_take_a_vehicle_that_is_flown(flown, sender) -> None:
    table = flown.server.commands.table
    owned = {number for number, entry in table.items() if entry.right is Right.OWNER}
    assert owned <= set(FOR_OWNER_ONLY)
    for number in owned:
        for params in FOR_OWNER_ONLY[number]:
            assert flown.command(number, *params, sender=sender) == REJECTED, number
        assert flown.texts() == [f"Command {number} refused: 1/191 has control"]
        assert flown.mode is FlightMode.OFFBOARD
        assert flown.armed


@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION])
@pytest.mark.parametrize("land", [(21, ()), (176, LAND)])
def test_everybody_may_land_it(flown, sender, land) -> None:
    assert flown.command(land[0], *land[1], sender=sender) == ACCEPTED
    assert flown.mode is FlightMode.LAND


@pytest.mark.parametrize("kill", [(400, KILL), (185, (1.0,))])
@pytest.mark.parametrize("sender", [STRANGER, GROUND_STATION, MAVSDK])
def test_ground_stations_may_stop_the_motors_and_strangers_may_not(flown, kill, sender) -> None:
    number, params = kill
    assert flown.command(number, *params, sender=sender) == (REJECTED if sender == STRANGER else ACCEPTED)
    assert flown.armed is (sender == STRANGER)


def test_parameters_of_a_flown_vehicle_belong_to_its_owner_too(flown) -> None:
    message = mav.MAVLink_param_set_message(1, 1, b"MAV_TYPE", 0.8, mav.MAV_PARAM_TYPE_REAL32)
    error, _ = flown.handle(message, STRANGER)
    assert error.error == mav.MAV_PARAM_ERROR_PERMISSION_DENIED
    assert flown.texts()[-1] == "MAV_TYPE refused: 1/191 has control"


def test_rates_may_be_raised_by_all_but_lowered_only_by_the_owner(flown) -> None:
    assert flown.command(511, 31.0, 10_000.0, sender=STRANGER) == ACCEPTED
    assert flown.command(511, 30.0, 20_000.0, sender=STRANGER) == REJECTED
    assert flown.command(511, 32.0, -1.0, sender=GROUND_STATION) == REJECTED
    assert flown.command(511, 30.0, 20_000.0) == ACCEPTED


def test_set_points_of_another_sender_are_dropped_with_one_text(flown) -> None:
    for _ in range(20):
        flown.handle(setpoint(0.1))
        flown.handle(setpoint(0.0, 0.5), STRANGER)
        flown.tick()
        assert flown.velocity_enu_m_s == pytest.approx((0.0, 0.1, 0.0))
    assert flown.texts() == ["Set-point dropped: 1/191 has control"]


def test_control_passes_on_when_the_owner_is_silent(flown) -> None:
    flown.run(flown.silence_s - 0.1)
    assert flown.command(176, *HOLD, sender=STRANGER) == REJECTED
    flown.run(0.15)
    assert flown.command(176, *HOLD, sender=STRANGER) == ACCEPTED
    assert flown.mode is FlightMode.HOLD


BAD = {
    "not a number": (setpoint(NAN), "not finite"),
    "infinite": (setpoint(0.0, math.inf), "not finite"),
    "fast": (setpoint(0.0, 0.0, 5.01), "above 5 m/s"),
    "fast together": (setpoint(4.0, 4.0), "above 5 m/s"),
    "absurd": (setpoint(1e9), "above 5 m/s"),
    "no mask": (setpoint(mask=0), "only velocity"),
    "position": (setpoint(mask=2552), "only velocity"),
    "two of three axes": (setpoint(mask=2503 | 8), "only velocity"),
    "acceleration": (setpoint(mask=2503 & ~64), "only velocity"),
    "offset frame": (setpoint(frame=7), "frame 7, only 1 or 8"),
    "body offset frame": (setpoint(frame=9), "frame 9"),
    "body FRD frame": (setpoint(frame=12), "frame 12"),
    "yaw": (setpoint(yaw=NAN), "yaw not finite"),
    "yaw rate not a number": (setpoint(mask=1479, rate=NAN), "yaw rate above"),
    "yaw rate": (setpoint(mask=1479, rate=100.0), "yaw rate above"),
}


def test_offboard_needs_a_living_stream(fresh) -> None:
    flying = fresh("fly")
    assert flying.command(176, *OFFBOARD) == REJECTED
    assert flying.texts()[-1] == "Mode offboard refused: no set-points"
    flying.run(0.1, (1.0, 0.0, 0.0))
    assert math.hypot(*flying.velocity_enu_m_s[:2]) < 0.05  # set-points without OFFBOARD have no effect
    flying.run(flying.silence_s + 0.1)
    assert flying.command(176, *OFFBOARD) == REJECTED
    flying.run(0.1, (0.0, 0.0, 0.0))
    assert flying.command(176, *OFFBOARD) == ACCEPTED
    assert flying.mode is FlightMode.OFFBOARD
    flying.run(0.02)
    beat = flying.seen(mav.MAVLINK_MSG_ID_HEARTBEAT)[-1]
    assert (beat.base_mode, beat.custom_mode) == (145, 393216)


@pytest.mark.parametrize("name", BAD)
def test_bad_set_points_are_dropped_with_one_text_and_keep_no_stream_alive(flown, name) -> None:
    bad, reason = BAD[name]
    good = flown.velocity_enu_m_s
    for _ in range(45):
        flown.handle(bad)
        flown.tick()
        assert flown.velocity_enu_m_s == good
    dropped = [t for t in flown.texts() if t.startswith("Set-point dropped")]
    assert len(dropped) == 1
    assert reason in dropped[0]
    for _ in range(round(100 * (flown.silence_s - 0.35))):
        flown.handle(bad)
        flown.tick()
    assert flown.command(176, *HOLD, sender=STRANGER) == ACCEPTED


def test_axes_and_signs() -> None:
    velocity, yaw_rad, rate = read_setpoint(setpoint(0.1, 0.2, -0.3, yaw=0.0), lambda: 1.0)
    assert velocity == (0.2, 0.1, 0.3)
    assert (yaw_rad, rate) == (pytest.approx(math.pi / 2), 0.0)  # the nose points north
    north = read_setpoint(setpoint(1.0, 0.5, 0.25, frame=8, mask=1479, rate=0.5), lambda: math.pi / 2)
    assert north.velocity_enu_m_s == pytest.approx((0.5, 1.0, -0.25))
    assert (north.yaw_rad, north.yaw_rate_rad_s) == (None, -0.5)  # a NED yaw rate is clockwise


def test_a_body_frame_needs_the_heading() -> None:
    dropped = read_setpoint(setpoint(1.0, frame=8), lambda: None)
    assert dropped == "Set-point dropped: body frame, but the heading is not known"
