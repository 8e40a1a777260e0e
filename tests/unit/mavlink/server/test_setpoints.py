"""Velocity set-points: which are accepted, and how they are read."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.server.profile import FlightMode
from bridge.mavlink.server.setpoints import read_setpoint
from tests.unit.autopilot.autopilot_fakes import setpoint
from tests.unit.mavlink.server.served import ACCEPTED, HOLD, NAN, OFFBOARD, REJECTED, STRANGER

FRAMES = {1: False, 8: True}
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
    assert math.hypot(*flying.velocity_enu_m_s[:2]) < 0.05  # streaming alone moves nothing
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


@pytest.mark.parametrize("mask", [2503, 1479, 3527, 4039])
def test_masks_that_clients_use_are_taken(flown, mask: int) -> None:
    flown.handle(setpoint(0.2, mask=mask))
    flown.tick()
    assert flown.velocity_enu_m_s == pytest.approx((0.0, 0.2, 0.0))


def test_set_points_for_another_vehicle_are_ignored(flown) -> None:
    flown.handle(setpoint(0.5, target=(2, 1)))
    flown.tick()
    assert flown.velocity_enu_m_s == pytest.approx((0.0, 0.1, 0.0))


def test_axes_and_signs() -> None:
    velocity, yaw_rad, rate = read_setpoint(setpoint(0.1, 0.2, -0.3, yaw=0.0), lambda: 1.0, FRAMES)
    assert velocity == (0.2, 0.1, 0.3)
    assert (yaw_rad, rate) == (pytest.approx(math.pi / 2), 0.0)  # nose to the north
    north = read_setpoint(setpoint(1.0, 0.5, 0.25, frame=8, mask=1479, rate=0.5), lambda: math.pi / 2, FRAMES)
    assert north.velocity_enu_m_s == pytest.approx((0.5, 1.0, -0.25))
    assert (north.yaw_rad, north.yaw_rate_rad_s) == (None, -0.5)  # clockwise in NED


def test_a_body_frame_needs_the_heading() -> None:
    dropped = read_setpoint(setpoint(1.0, frame=8), lambda: None, FRAMES)
    assert dropped == "Set-point dropped: body frame, but the heading is not known"
