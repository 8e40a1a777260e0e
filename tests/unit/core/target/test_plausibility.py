"""Whether the numbers of the own state are measured anew."""

import pytest

from flightstack.core.target.plausibility import STANDING_M_S, STILL_MAX_S, Plausibility
from flightstack.core.types import OwnState
from tests.unit.core.core_helpers import config

CONFIG = config()

PERIOD_S = 0.02


def believed_s(seconds, speed_m_s, *, flies, moves_m=0.0):
    """How long a vehicle is believed whose position changes by so much in a period."""
    watched, age_s = Plausibility(CONFIG), CONFIG.checks.own_age_max_s
    for k in range(round(seconds / PERIOD_S)):
        at_s = PERIOD_S * k
        watched.take(OwnState(at_s, at_s, (k * moves_m, 0.0, 1.0), (speed_m_s, 0.0, 0.0), 0.0), flies=flies)
        if not watched.believes(at_s):
            return at_s - age_s
    return seconds


@pytest.mark.parametrize("speed_m_s", [0.0, 0.002, 0.02, 0.049])
def test_a_vehicle_at_rest_repeats_its_numbers_for_as_long_as_it_likes(speed_m_s):
    if speed_m_s < 0.03:  # more is a contradiction of position and velocity in the long run
        assert believed_s(60.0, speed_m_s, flies=False) == 60.0
    assert believed_s(1.0, speed_m_s, flies=False) == 1.0


@pytest.mark.parametrize("flies", [False, True])
def test_numbers_that_repeat_in_motion_are_no_news_at_once(flies):
    assert believed_s(5.0, 1.1 * STANDING_M_S, flies=flies) <= 2 * PERIOD_S


@pytest.mark.parametrize("speed_m_s", [0.0, 0.04])
def test_a_state_that_hangs_in_a_hover_is_no_news_after_a_while(speed_m_s):
    assert believed_s(5.0, speed_m_s, flies=True) == pytest.approx(STILL_MAX_S, abs=2 * PERIOD_S)
    assert believed_s(5.0, 0.01, flies=True, moves_m=1e-4) == 5.0
