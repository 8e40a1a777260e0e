"""Numbers that repeat: a vehicle at rest may send them, one that moves may not."""

import pytest

from flightstack.core.target.plausibility import STANDING_M_S, repeats

PLACE = (0.012, -0.012, 0.0)


@pytest.mark.parametrize(
    ("velocity_m_s", "stuck"),
    [
        ((0.0, 0.0, 0.0), False),
        ((0.009, 0.0, 0.0), False),  # the accelerometer's bias of a Crazyflie at rest
        ((0.0, 0.03, 0.03), False),
        ((0.0, 0.03, -0.05), True),
        ((0.0, 0.0, 1.01 * STANDING_M_S), True),
    ],
)
def test_the_same_position_again_is_stuck_only_beyond_what_a_bias_shows_at_rest(velocity_m_s, stuck):
    assert repeats(PLACE, PLACE, velocity_m_s) is stuck
    assert not repeats(PLACE, (0.013, -0.012, 0.0), velocity_m_s)
