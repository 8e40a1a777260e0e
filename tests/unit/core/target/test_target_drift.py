"""Tests which contradictions of a target's positions and velocity are detected, and how soon."""

import math
import random

import pytest

from flightstack.core.parameters.flight import Checks
from flightstack.core.target.plausibility import STANDING_M_S, STILL_MAX_S, Plausibility
from flightstack.core.target.track import TargetTrack
from flightstack.core.types import OwnState, TargetSample
from tests.unit.core.core_helpers import config

RATE_HZ = 50.0


def turned(velocity, angle_rad):
    (x, y, z), c, s = velocity, math.cos(angle_rad), math.sin(angle_rad)
    return c * x - s * y, s * x + c * y, z


# wrongly reported velocity as a function of true velocity, heading and time
WRONG = {
    "world frame": lambda v, yaw, t: turned(v, yaw),
    "heading off by half a turn": lambda v, yaw, t: turned(v, math.pi),
    "flips every other second": lambda v, yaw, t: turned(v, math.pi * (int(t) % 2)),
    "body axes swapped": lambda v, yaw, t: turned(turned(v, -yaw)[1::-1] + v[2:], yaw),
    "twice": lambda v, yaw, t: tuple(2.0 * c for c in v),
    "half": lambda v, yaw, t: tuple(0.5 * c for c in v),
    "zero": lambda v, yaw, t: (0.0, 0.0, 0.0),
    "climbs": lambda v, yaw, t: (v[0], v[1], 0.1),
}


def drive(checks, seconds, *, speed=0.2, yaw=2.5, turn_rate=0.0, says=lambda v, yaw, t: v, noise=(), lost=()):
    """Track a robot that drives; yield time, track and true velocity after each sample."""
    track, chance, (x, y) = TargetTrack(checks), random.Random(1), (0.0, 0.0)
    track.memory.settled = True
    position_m, velocity_m_s = noise or (0.0, 0.0)
    for n in range(int(seconds * RATE_HZ)):
        t, heading = n / RATE_HZ, yaw + turn_rate * n / RATE_HZ
        true = turned((speed, 0.0, 0.0), heading)
        x, y = x + true[0] / RATE_HZ, y + true[1] / RATE_HZ
        if any(begin <= t % 5.0 < end for begin, end in lost):
            continue
        place = tuple(chance.gauss(c, position_m) for c in (x, y, 0.2))
        told = tuple(chance.gauss(c, velocity_m_s) for c in says(true, heading, t))
        track.accept(TargetSample(t, 1000.0 + t, "map", "target", place, told, heading, turn_rate))
        yield t, track, true


@pytest.mark.parametrize("fault", WRONG)
@pytest.mark.parametrize("yaw", [1.0, 2.5, -2.0])
def test_a_velocity_that_the_positions_contradict_is_soon_noticed(fault, yaw):
    noticed_s = next(
        t for t, track, _ in drive(Checks(), 4.0, yaw=yaw, says=WRONG[fault]) if track.memory.distrusted
    )
    # a drift counts above 0.1 m, after a low-pass of 0.2 s; the accumulated drift decays within about 2 s
    assert noticed_s < (2.0 if fault in ("half", "climbs", "flips every other second") else 1.3)


def test_then_the_velocity_is_that_of_the_positions():
    *_, (_, track, true) = drive(Checks(), 3.0, says=WRONG["world frame"])
    assert track.moves_m_s == pytest.approx(true, abs=0.01)


@pytest.mark.parametrize(
    "robot",
    [
        {"speed": 0.5, "turn_rate": 0.5, "noise": (0.01, 0.03), "lost": ((2.0, 2.2),)},
        {"speed": 0.3, "turn_rate": -2.0, "noise": (0.02, 0.06)},
        {"speed": 1.0, "noise": (0.005, 0.02), "says": lambda v, yaw, t: tuple(0.97 * c for c in v)},
        {"speed": 0.0, "noise": (0.02, 0.06), "lost": ((1.0, 1.3),)},
    ],
)
def test_noise_bends_and_gaps_are_no_contradiction(robot):
    worst = max(math.hypot(*t.memory.drift_smooth_m) for _, t, _ in drive(Checks(), 60.0, **robot))
    assert worst < 0.8 * Checks().target_drift_max_m


@pytest.mark.parametrize(("settled", "last"), [(False, False), (True, True)])
def test_it_is_believed_again_once_in_a_flight_and_always_on_the_ground(settled, last):
    seen = []
    for t, track, _ in drive(
        Checks(), 40.0, says=lambda v, yaw, t: v if int(t) % 20 > 3 else (0.0, 0.0, 0.0)
    ):
        track.memory.settled = settled
        seen.append((t, track.memory.distrusted))
    assert not any(distrusted for t, distrusted in seen if 10.0 < t < 20.0)
    assert next(distrusted for t, distrusted in seen if t > 32.0) is last
    assert seen[-1][1] is last


CONFIG = config()

PERIOD_S = 0.02


def believed_s(seconds, speed_m_s, *, flies, moves_m=0.0):
    """Return for how long the state is trusted, s; the position moves by ``moves_m`` in each period."""
    watched, age_s = Plausibility(CONFIG), CONFIG.checks.own_age_max_s
    for k in range(round(seconds / PERIOD_S)):
        at_s = PERIOD_S * k
        watched.take(OwnState(at_s, at_s, (k * moves_m, 0.0, 1.0), (speed_m_s, 0.0, 0.0), 0.0), flies=flies)
        if not watched.trusts(at_s):
            return at_s - age_s
    return seconds


@pytest.mark.parametrize("speed_m_s", [0.0, 0.002, 0.02, 0.049])
def test_a_vehicle_at_rest_repeats_its_numbers_for_as_long_as_it_likes(speed_m_s):
    if speed_m_s < 0.03:  # after some seconds, a higher reported velocity contradicts the constant position
        assert believed_s(60.0, speed_m_s, flies=False) == 60.0
    assert believed_s(1.0, speed_m_s, flies=False) == 1.0


@pytest.mark.parametrize("flies", [False, True])
def test_numbers_that_repeat_in_motion_are_no_news_at_once(flies):
    assert believed_s(5.0, 1.1 * STANDING_M_S, flies=flies) <= 2 * PERIOD_S


@pytest.mark.parametrize("speed_m_s", [0.0, 0.04])
def test_a_state_that_hangs_in_a_hover_is_no_news_after_a_while(speed_m_s):
    assert believed_s(5.0, speed_m_s, flies=True) == pytest.approx(STILL_MAX_S, abs=2 * PERIOD_S)
    assert believed_s(5.0, 0.01, flies=True, moves_m=1e-4) == 5.0
