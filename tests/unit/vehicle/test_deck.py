"""The deck of the vehicle process: decoding, dead reckoning, gentle correction."""

from __future__ import annotations

import math

import pytest

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import encode_odometry
from bridge.target.odometry import OdometryError
from sim.runners.deck import DeckDecoder, DeckState, follow, reckon

Q_NORTH = quaternion_from_yaw(math.pi / 2)


def message(x_m: float, *, frame: str = "map", q=Q_NORTH) -> bytes:
    return encode_odometry(5, frame, "target", (x_m, 2.0, 0.2), q, (0.5, 0.1, 0.0), (0.0, 0.0, 0.3))


def test_decodes_into_the_world_frame_also_when_the_frame_names_change() -> None:
    decoder = DeckDecoder()
    for frame in ("map", "map", "a_longer_name", "map"):
        deck = decoder.decode(message(1.0, frame=frame))
        assert deck.position_enu_m == (1.0, 2.0, 0.2)
        assert deck.velocity_enu_m_s == pytest.approx((-0.1, 0.5, 0.0))
        assert deck.yaw_rad == pytest.approx(math.pi / 2)
        assert deck.yaw_rate_rad_s == 0.3


@pytest.mark.parametrize("payload", [b"", b"\x00\x01\x00\x00", message(1.0)[:-9], message(math.nan)])
def test_refuses_what_is_cut_or_not_finite(payload: bytes) -> None:
    decoder = DeckDecoder()
    decoder.decode(message(1.0))
    with pytest.raises(OdometryError):
        decoder.decode(payload)


def test_dead_reckoning_stays_on_the_arc() -> None:
    radius_m, rate = 2.0, 0.4
    start = DeckState((radius_m, 0.0, 0.2), math.pi / 2, (0.0, radius_m * rate, 0.0), rate, b"")
    there = reckon(start, 0.1)
    assert math.hypot(*there.position_enu_m[:2]) == pytest.approx(radius_m, abs=2e-5)
    assert there.yaw_rad == pytest.approx(math.pi / 2 + 0.04)
    assert math.hypot(*there.velocity_enu_m_s) == pytest.approx(radius_m * rate)


def test_a_small_error_is_pulled_out_without_a_jump_and_a_large_one_is_not() -> None:
    robot = DeckState((0.0, 0.0, 0.2), 0.0, (0.2, 0.0, 0.0), 0.0, b"")
    x, yaw, dt = -0.02, 0.05, 0.01
    for k in range(100):
        deck = follow(robot, k * dt, (x, 0.0, 0.2), yaw)
        assert deck.position_enu_m == (x, 0.0, 0.2)
        assert abs(deck.velocity_enu_m_s[0] - 0.2) <= 0.1 + 1e-9
        x += deck.velocity_enu_m_s[0] * dt
        yaw += deck.yaw_rate_rad_s * dt
    assert x == pytest.approx(0.2, abs=1e-3)
    assert yaw == pytest.approx(0.0, abs=1e-3)
    far = follow(robot, 0.0, (5.0, 0.0, 0.2), 0.0)
    assert far.position_enu_m == robot.position_enu_m
