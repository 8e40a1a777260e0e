"""Compares the downwash on a lower vehicle with published values, momentum and symmetry."""

import math

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.plant.air import AIR_KG_M3, JET, DownwashRecord, feel, jet_speed, press, set_jet, set_up_downwash
from sim.plant.params import load

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
    """Return force and torque on a Crazyflie with its rotors ``down`` below those of one that hovers
    at x, y."""
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
    """The constants fit their unit of length l; with a quarter of l the result would be 0.06."""
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
    """The downwash force agrees with Neural-Swarm (arXiv 2003.02992), figure 3, a 34 g Crazyflie.

    Measured were 10, 8, 6 and 4 gram-force at 0.2, 0.3, 0.4 and 0.5 m below the upper vehicle.
    """
    measured = {0.2: 10.0, 0.3: 8.0, 0.4: 6.0, 0.5: 4.0}
    ours = {down: -below(0.0, 0.0, down)[0][2] / 9.81e-3 for down in measured}
    assert all(0.6 < ours[down] / grams < 1.4 for down, grams in measured.items())
    assert sum(ours.values()) == pytest.approx(sum(measured.values()), rel=0.15)
