"""Compares distances of two vehicles with closed forms; tests cylinders that nearly overlap."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest

from sim.plant.params import load
from sim.vehicle.judge import Shape, Team

SHAPE = Shape.of(load("crazyflie20"))
SMALL = Shape(0.05, -0.01, 0.02)
BOTH = np.ones(2, dtype=np.int64)


class Nearest(NamedTuple):
    """Smallest distances and collision of a vehicle pair."""

    distance_m: float
    ellipsoid: float
    overlap_ms: int


def nearest(before, after, steps, one, other):
    """Return the smallest distances of two vehicles; the states are relative to the first vehicle."""
    team = Team((one, other))
    team.follow(np.vstack((np.zeros(6), before)), np.vstack((np.zeros(6), after)), BOTH, steps)
    distance_m, flying_m, ellipsoid = team.least[0]
    assert flying_m == distance_m
    assert team.inside[0] == (ellipsoid < 1.0)
    return Nearest(distance_m, ellipsoid, team.overlap_ms[0])


def states(position, velocity, acceleration, seconds):
    """Return the relative state at start and end of a constant acceleration."""
    p, v, a = (np.array(each, dtype=float) for each in (position, velocity, acceleration))
    after = np.concatenate((p + v * seconds + 0.5 * a * seconds**2, v + a * seconds))
    return np.concatenate((p, v)), after


def test_a_straight_pass_is_judged_between_the_ticks():
    """A pass at 10 m/s, 5 ms after the first tick, is between the ticks."""
    before, after = states((-0.05, 0.3, 0.0), (10.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.01)
    found = nearest(before, after, 10, SMALL, SMALL)
    assert found.distance_m == pytest.approx(0.3)
    assert found.ellipsoid == pytest.approx(0.3 / 0.25)
    assert found.overlap_ms == -1


@pytest.mark.parametrize("axis", range(3))
def test_the_first_millisecond_of_an_overlap(axis):
    touch_m = (0.1, 0.1, 0.03)[axis]
    position, velocity = [0.0] * 3, [0.0] * 3
    position[axis], velocity[axis] = touch_m + 0.0045, -1.0
    before, after = states(position, velocity, (0.0, 0.0, 0.0), 0.01)
    assert nearest(before, after, 10, SMALL, SMALL).overlap_ms == 5


def test_a_team_is_all_its_pairs_and_keeps_the_least_of_those_that_fly():
    rng = np.random.default_rng(1)
    shapes = [SMALL, SHAPE, Shape(0.3, -0.1, 0.2), SHAPE]
    team, least = Team(shapes), np.full((6, 3), np.inf)
    for _ in range(50):
        before, after = (rng.normal(0.0, 0.6, (4, 6)) for _ in range(2))
        flew, seen = rng.integers(0, 2, 4), False
        told = team.follow(before, after, flew, 10)
        for number, (i, j) in enumerate(combinations(range(4), 2)):
            one, both = (
                nearest(before[j] - before[i], after[j] - after[i], 10, shapes[i], shapes[j]),
                flew[i] & flew[j],
            )
            found = (one.distance_m, *((one.distance_m, one.ellipsoid) if both else (np.inf, np.inf)))
            least[number] = np.minimum(least[number], found)
            assert (team.inside[number], team.overlap_ms[number]) == (found[2] < 1.0, one.overlap_ms)
            seen = seen or found[2] < 1.0 or one.overlap_ms >= 0
        assert told == seen
        assert (team.least == least).all()
