"""Compares distances of two vehicles with closed forms, and the downwash with published values."""

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.plant.air import AIR_KG_M3, JET, DownwashRecord, feel, jet_speed, press, set_jet, set_up_downwash
from sim.plant.params import load
from sim.vehicle.judge import Shape, Team

SHAPE = Shape.of(load("crazyflie20"))
SMALL = Shape(0.05, -0.01, 0.02)
BOTH = np.ones(2, dtype=np.int64)


class Nearest(NamedTuple):
    """Smallest distance and ellipsoid norm of two vehicles, and time of an overlap (-1: no overlap)."""

    distance_m: float
    ellipsoid: float
    overlap_ms: int


def nearest(before, after, steps, one, other):
    """Return the smallest distances between two ticks; the states are relative to the first vehicle."""
    team = Team((one, other))
    team.follow(np.vstack((np.zeros(6), before)), np.vstack((np.zeros(6), after)), BOTH, steps)
    distance_m, flying_m, ellipsoid = team.least[0]
    assert flying_m == distance_m
    assert team.inside[0] == (ellipsoid < 1.0)
    return Nearest(distance_m, ellipsoid, team.overlap_ms[0])


def states(position, velocity, acceleration, seconds):
    """Return the relative states before and after a time with constant acceleration."""
    p, v, a = (np.array(each, dtype=float) for each in (position, velocity, acceleration))
    after = np.concatenate((p + v * seconds + 0.5 * a * seconds**2, v + a * seconds))
    return np.concatenate((p, v)), after


def test_a_straight_pass_is_judged_between_the_ticks():
    """The smallest distance of a pass at 10 m/s is found, although the pass is 5 ms after a tick."""
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


CRAZYFLIE = load("crazyflie20")
WEIGHT_N = CRAZYFLIE.body.mass_kg * 9.81
UPRIGHT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def jet(thrust_n=WEIGHT_N):
    d = set_up_downwash(new(DownwashRecord), CRAZYFLIE.body, CRAZYFLIE.rotor, CRAZYFLIE.geometry)
    found = np.zeros(JET)
    set_jet(d, thrust_n, np.array([1.0, 2.0, 3.0]), UPRIGHT, found)
    return found.tolist()


HOVER_M_S, SIZE_M = jet()[6:]


def below(x, y, down, *, jets=None, axes=UPRIGHT):
    """Return force, N, and torque, N m, on a Crazyflie at the origin, whose rotors are ``down`` m below the
    rotors of a Crazyflie that hovers at x, y."""
    d = set_up_downwash(new(DownwashRecord), CRAZYFLIE.body, CRAZYFLIE.rotor, CRAZYFLIE.geometry)
    jets = np.array([[x, y, 0.0, 0.0, 0.0, -1.0, HOVER_M_S, SIZE_M]]) if jets is None else jets
    feel(d, jets, 99, np.array([0.0, 0.0, -down - d.above]), axes)
    force, torque = np.zeros(3), np.zeros(3)
    if d.on:
        press(d, axes, force, torque)
    return force, torque


def test_the_induced_velocity_is_that_of_momentum_theory():
    area = 4.0 * math.pi * CRAZYFLIE.rotor.radius_m**2
    assert 2.0 * AIR_KG_M3 * area * HOVER_M_S**2 == pytest.approx(WEIGHT_N)
    assert pytest.approx(math.hypot(2 * 0.03253, 2 * 0.03253)) == SIZE_M
    assert jet()[:6] == [1.0, 2.0, 3.012, 0.0, 0.0, -1.0]
    assert jet(0.0)[6] == jet(-0.01)[6] == 0.0


@pytest.mark.parametrize("lengths", [2.5, 5.0, 10.0, 30.0])
def test_the_axis_and_the_half_width_are_the_published_ones(lengths):
    speed = jet_speed(lengths * 0.2, 0.0, 3.0, 0.2)
    assert speed == pytest.approx(3.0 * 10.11 / (lengths + 5.817))
    half_m = 0.07668 * (lengths + 5.817) * 0.2
    assert jet_speed(lengths * 0.2, half_m, 3.0, 0.2) == pytest.approx(0.5 * speed)


def test_the_jet_carries_the_momentum_of_the_thrust():
    """The jet carries 90 to 100 % of the thrust's momentum; if l were a quarter, the share would be 6 %."""
    for down in (0.3, 1.0, 2.0):
        r = np.linspace(0.0, 3.0, 6001)
        u = np.array([jet_speed(down, each, HOVER_M_S, SIZE_M) for each in r])
        carried = np.trapezoid(AIR_KG_M3 * u**2 * 2.0 * math.pi * r, r)
        assert 0.9 < carried / WEIGHT_N < 1.0


def test_nothing_above_and_nothing_far_beside():
    for down in (-0.001, -0.3, -5.0):
        assert jet_speed(down, 0.0, HOVER_M_S, SIZE_M) == 0.0
    edge_m = 4.0 * 0.07668 * (1.0 + 5.817 * SIZE_M)
    assert jet_speed(1.0, 0.999 * edge_m, HOVER_M_S, SIZE_M) > 0.0
    assert jet_speed(1.0, 1.001 * edge_m, HOVER_M_S, SIZE_M) == 0.0
    for place in ((0.0, 0.0, -0.5), (3.0, 0.0, 1.0), (0.0, -2.0, 0.0)):
        force, torque = below(*place)
        assert not force.any()
        assert not torque.any()


def test_it_is_of_the_size_of_measurements():
    """The model's downwash force agrees with measurements of Neural-Swarm (arXiv 2003.02992, figure 3).

    The measured forces are 10, 8, 6 and 4 gram-force at 0.2, 0.3, 0.4 and 0.5 m below the upper vehicle.
    """
    measured = {0.2: 10.0, 0.3: 8.0, 0.4: 6.0, 0.5: 4.0}
    ours = {down: -below(0.0, 0.0, down)[0][2] / 9.81e-3 for down in measured}
    assert all(0.6 < ours[down] / grams < 1.4 for down, grams in measured.items())
    assert sum(ours.values()) == pytest.approx(sum(measured.values()), rel=0.15)
