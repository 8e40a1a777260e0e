"""Ground effect against its closed form, gusts against their spectrum, two identifications of the motor."""

import math

import numpy as np
import pytest

from sim.compiled.rotation import rotation_axes
from sim.plant.ground_effect import GroundEffect
from sim.plant.params import load
from sim.plant.wind import WindModel
from sim.scenarios.scenario import Wind
from tests.independent_plant import THRUST

PARAMS = load()
RADIUS_M = 0.0231
LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
WIND_STEP_S = 0.005


@pytest.mark.parametrize("gain", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("height_m", [0.020, 0.0264, 0.035, 0.050, 0.069])
def test_ground_effect_is_cheeseman_and_bennetts(height_m, gain):
    closed = 1.0 / (1.0 - (RADIUS_M / (4.0 * height_m)) ** 2) - 1.0
    effect = GroundEffect(PARAMS.rotor, gain, 0.1)
    assert effect.increase(height_m) == pytest.approx(gain * closed, rel=1e-12)
    above_pad = height_m - PARAMS.rotor.above_com_m
    assert effect.factors(0.0, 0.0, above_pad, 0.2, LEVEL) == pytest.approx([1.0 + gain * closed] * 4)


def test_a_tilted_vehicle_feels_every_rotor_at_its_own_height():
    angle = math.radians(10.0)
    axes = rotation_axes((math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))  # nose down
    effect = GroundEffect(PARAMS.rotor, 1.0, 0.5)
    front = 0.04 + PARAMS.rotor.above_com_m * math.cos(angle) - PARAMS.rotor.arm_m * math.sin(angle)
    rear = front + 2.0 * PARAMS.rotor.arm_m * math.sin(angle)
    got = effect.factors(0.0, 0.0, 0.04, 0.2, axes)
    closed = [1.0 / (1.0 - (RADIUS_M / (4.0 * h)) ** 2) for h in (front, rear, rear, front)]
    assert got == pytest.approx(closed, rel=1e-12)


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
    error = np.sqrt(times_s() / (WIND_STEP_S * len(gusts)))  # of an rms from correlated samples
    assert (np.abs(gusts.std(axis=0) / wanted - 1.0) < 3.5 * error).all()
    assert (np.abs(gusts.mean(axis=0)) < 3.5 * wanted * error * math.sqrt(2.0)).all()
    assert abs(np.corrcoef(gusts.T)[np.triu_indices(3, 1)]).max() < 0.2


def test_gusts_forget_exponentially(gusts):
    for i, time in enumerate(times_s()):
        g = gusts[:, i] - gusts[:, i].mean()
        for lag_s in (0.2 * time, time):
            n = round(lag_s / WIND_STEP_S)
            assert (g[n:] @ g[:-n]) / (g @ g) == pytest.approx(math.exp(-lag_s / time), abs=0.12)


def test_gusts_have_the_first_order_spectrum(gusts):
    """Power in octaves of frequency against 4 s^2 T / (1 + (2 pi f T)^2)."""
    frequency = np.fft.rfftfreq(len(gusts), WIND_STEP_S)
    for i, time in enumerate(times_s()):
        rms = 0.5 * (1.0 if i < 2 else PARAMS.wind.vertical_share)
        power = 2.0 * WIND_STEP_S / len(gusts) * np.abs(np.fft.rfft(gusts[:, i])) ** 2
        density = 4.0 * rms**2 * time / (1.0 + (2.0 * math.pi * frequency * time) ** 2)
        for low in (0.05, 0.2, 0.8, 3.2, 12.8):
            band = (frequency >= low) & (frequency < 2.0 * low)
            error = 1.0 / math.sqrt(band.sum())
            assert power[band].mean() == pytest.approx(density[band].mean(), rel=4.0 * error + 0.02)


def test_thrust_map_and_the_firmwares_voltage_curve_agree_within_six_percent():
    """Two identifications of the same motor: the firmware's cubic of volts, and speed and thrust of L250.

    Counts are linear in the thrust of the first; the simulator makes them linear in that of the second.
    """
    cubic = np.array([0.0059609239, -0.0184736436, 0.0472446524, -0.0148307449])  # platform_defaults_cf2.h
    for thrust in np.linspace(0.03, 0.12, 10):
        volts = next(r.real for r in np.roots(cubic - [0, 0, 0, thrust]) if abs(r.imag) < 1e-9)
        rpm = PARAMS.battery.speed_at_zero_v_rpm + PARAMS.battery.speed_per_volt_rpm * volts
        assert np.polyval(THRUST, rpm) == pytest.approx(thrust, rel=0.06)
