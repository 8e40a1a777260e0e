"""Tests rotors against their maps, ground effect against its closed form, battery and gusts."""

import itertools
import math

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.plant.params import load
from sim.plant.rotors import GroundRecord, ground_effect, set_up_ground, thrust_increase
from sim.plant.states import rotation_axes

PARAMS = load()
ROTOR = PARAMS.rotor


LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def ground(gain=1.0, pad_radius_m=0.1):
    return set_up_ground(new(GroundRecord), ROTOR, gain, pad_radius_m)


def factors(g, ex, ey, ez, axes=LEVEL):
    """Return the factors on the four thrusts, above a pad at 0.2 m."""
    out = np.empty(4)
    ground_effect(g, ex, ey, ez, 0.2, axes, out)
    return out.tolist()


def test_ground_effect_is_clipped_fades_out_and_never_jumps():
    assert thrust_increase(ground(), 0.005) == thrust_increase(ground(), 0.020)
    assert thrust_increase(ground(), 4.0 * ROTOR.radius_m) == 0.0
    values = [thrust_increase(ground(), 0.001 * k / 10.0) for k in range(1200)]
    assert max(abs(a - b) for a, b in itertools.pairwise(values)) < 1e-3
    assert all(a >= b for a, b in itertools.pairwise(values))


def test_at_the_edge_only_the_rotors_over_the_pad_gain_and_far_away_none():
    front_right, rear_right, rear_left, front_left = factors(ground(), 0.1, 0.0, 0.0144)
    assert rear_right == rear_left > 1.03
    assert front_right == front_left == 1.0
    assert factors(ground(), 0.0, 0.0, 0.5) == factors(ground(), 1.0, 0.0, 0.1) == [1.0] * 4


def test_a_tilted_vehicle_feels_every_rotor_at_its_own_height():
    angle = math.radians(10.0)
    axes = rotation_axes((math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))  # attitude with the nose down
    front = 0.04 + ROTOR.above_com_m * math.cos(angle) - ROTOR.arm_m * math.sin(angle)
    rear = front + 2.0 * ROTOR.arm_m * math.sin(angle)
    closed = [1.0 / (1.0 - (ROTOR.radius_m / (4.0 * h)) ** 2) for h in (front, rear, rear, front)]
    assert factors(ground(1.0, 0.5), 0.0, 0.0, 0.04, axes) == pytest.approx(closed, rel=1e-12)
