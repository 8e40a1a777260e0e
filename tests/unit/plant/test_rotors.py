"""Rotors compared with their maps, ground effect with its closed form, battery, gusts."""

import itertools
import math

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.plant.ground_effect import GroundRecord, ground_effect, set_up_ground, thrust_increase
from sim.plant.params import STEP_S, Plant, load
from sim.plant.rotation import rotation_axes
from sim.plant.rotors import (
    BatteryModel,
    Rotors,
    drain,
    turn_rotors,
)
from sim.plant.wind import WindModel
from sim.scenarios.scenario import Wind

PARAMS = load()
WIND_STEP_S = 0.005
ROTOR = PARAMS.rotor
WEIGHT_N = PARAMS.body.mass_kg * PARAMS.contact.gravity_m_s2
HOVER = ROTOR.rpm(WEIGHT_N / 4.0)


def rotors(slow=False, **factors):
    return Rotors(ROTOR, Plant(**factors), slow, STEP_S)


def turn(r, command, wx=0.0, wy=0.0):
    """Run one step of 1 ms without ground effect; return the wrench."""
    turn_rotors(r.record, np.array(command), wx, wy)
    return r.record


def settled(command, **factors):
    r = rotors(**factors)
    r.rpm = command
    return turn(r, command)


def test_hover_thrust_carries_the_weight():
    assert abs(HOVER - 18968) < 20  # computed by hand from the L250 map
    assert settled((HOVER,) * 4).thrust_n == pytest.approx(WEIGHT_N, rel=1e-9)
    assert settled((HOVER,) * 4, thrust=0.9).thrust_n == pytest.approx(0.9 * WEIGHT_N, rel=1e-9)


LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def ground(gain=1.0, pad_radius_m=0.1):
    return set_up_ground(new(GroundRecord), ROTOR, gain, pad_radius_m)


def factors(g, ex, ey, ez, axes=LEVEL):
    """Return the factors on the four thrusts, above a pad at 0.2 m."""
    out = np.empty(4)
    ground_effect(g, ex, ey, ez, 0.2, axes, out)
    return out.tolist()


@pytest.mark.parametrize("gain", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("height_m", [0.020, 0.0264, 0.035, 0.050, 0.069])
def test_ground_effect_is_cheeseman_and_bennetts(height_m, gain):
    closed = 1.0 / (1.0 - (ROTOR.radius_m / (4.0 * height_m)) ** 2) - 1.0
    assert thrust_increase(ground(gain), height_m) == pytest.approx(gain * closed, rel=1e-12)
    above = height_m - ROTOR.above_com_m
    assert factors(ground(gain), 0.0, 0.0, above) == pytest.approx([1.0 + gain * closed] * 4)
    # away from the pad the floor has the effect
    assert factors(ground(gain), 1.0, 0.0, above - 0.2) == pytest.approx([1.0 + gain * closed] * 4)


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
    axes = rotation_axes((math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))  # nose down
    front = 0.04 + ROTOR.above_com_m * math.cos(angle) - ROTOR.arm_m * math.sin(angle)
    rear = front + 2.0 * ROTOR.arm_m * math.sin(angle)
    closed = [1.0 / (1.0 - (ROTOR.radius_m / (4.0 * h)) ** 2) for h in (front, rear, rear, front)]
    assert factors(ground(1.0, 0.5), 0.0, 0.0, 0.04, axes) == pytest.approx(closed, rel=1e-12)


def test_battery_sags_in_hover_and_drains_in_seven_minutes():
    battery = BatteryModel(PARAMS.battery, HOVER)
    assert battery.voltage_v == pytest.approx(4.14, abs=0.01)
    drain(battery.record, np.full(4, HOVER), 0.01)
    assert battery.voltage_v == pytest.approx(3.90, abs=0.01)
    assert battery.rpm_max > ROTOR.rpm(ROTOR.thrust_max_n)
    for _ in range(411):
        drain(battery.record, np.full(4, HOVER), 1.0)
    assert battery.voltage_v == pytest.approx(3.25, abs=0.01)


@pytest.fixture(scope="module")
def gusts():
    wind = WindModel(Wind(0.0, 0.5, 0.0), PARAMS.wind, 7, WIND_STEP_S)
    out = np.empty((120_000, 3))  # 600 s
    for k in range(len(out)):
        wind.step()
        out[k] = wind.now_enu_m_s
    return out


def times_s():
    return np.array([PARAMS.wind.horizontal_time_s] * 2 + [PARAMS.wind.vertical_time_s])


def test_gusts_have_their_rms(gusts):
    wanted = 0.5 * np.array([1.0, 1.0, PARAMS.wind.vertical_share])
    error = np.sqrt(times_s() / (WIND_STEP_S * len(gusts)))  # error of an rms value from correlated samples
    assert (np.abs(gusts.std(axis=0) / wanted - 1.0) < 3.5 * error).all()
    assert (np.abs(gusts.mean(axis=0)) < 3.5 * wanted * error * math.sqrt(2.0)).all()
    assert abs(np.corrcoef(gusts.T)[np.triu_indices(3, 1)]).max() < 0.2


def test_gusts_have_the_first_order_spectrum(gusts):
    """Compare the power per octave of frequency with 4 s^2 T / (1 + (2 pi f T)^2)."""
    frequency = np.fft.rfftfreq(len(gusts), WIND_STEP_S)
    for i, time in enumerate(times_s()):
        rms = 0.5 * (1.0 if i < 2 else PARAMS.wind.vertical_share)
        power = 2.0 * WIND_STEP_S / len(gusts) * np.abs(np.fft.rfft(gusts[:, i])) ** 2
        density = 4.0 * rms**2 * time / (1.0 + (2.0 * math.pi * frequency * time) ** 2)
        for low in (0.05, 0.2, 0.8, 3.2, 12.8):
            band = (frequency >= low) & (frequency < 2.0 * low)
            error = 1.0 / math.sqrt(band.sum())
            assert power[band].mean() == pytest.approx(density[band].mean(), rel=4.0 * error + 0.02)
