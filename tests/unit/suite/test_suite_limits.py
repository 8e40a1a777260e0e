"""The suite's limits for PX4 against its velocity loop in gusts: who follows passes, who does not, fails."""

import numpy as np
import pytest

from tests.flight_suite.room import LIMITS

P_1_S, I_1_S2 = 1.8, 0.4  # MPC_XY_VEL_P_ACC, MPC_XY_VEL_I_ACC
HOLD_1_S = 0.95  # MPC_XY_P, which holds the place in the take-off
THRUST_LAG_S = 0.15  # attitude loop and motors of a quadrotor of 1 kg; assumption
DRAG_1_S = 1.0  # SIH_KDV on 1 kg
WIND_M_S, GUST_M_S, GUST_S = 0.5, 0.2, 2.0  # scenario `large`; correlation of sim/vehicles/quad_1000g.toml
TAKEOFF_S, HOLD_S, STOP_S = 4.0, 5.0, 2.0
FLIGHTS, STEP_S = 2000, 0.01
PX4 = LIMITS["px4"]


class Gusts:
    """Wind over all flights, one complex number each: east + i north, m/s."""

    def __init__(self, chance):
        self._chance = chance
        self._mean = WIND_M_S * np.exp(2j * np.pi * chance.random(FLIGHTS))
        self._gust = GUST_M_S * self._normal()
        self._decay = np.exp(-STEP_S / GUST_S)

    def _normal(self):
        return self._chance.standard_normal(FLIGHTS) + 1j * self._chance.standard_normal(FLIGHTS)

    def next(self):
        kick = GUST_M_S * np.sqrt(1.0 - self._decay**2)
        self._gust = self._decay * self._gust + kick * self._normal()
        return self._mean + self._gust


def flown(obeys):
    """Drift (m), share of the way, speed at the end of the hold and of the stop (m/s), of all flights."""
    gusts = Gusts(np.random.default_rng(1))
    x = v = integral = thrust = np.zeros(FLIGHTS, complex)
    ends = np.cumsum([TAKEOFF_S, PX4.settle_s, HOLD_S, PX4.step_s, PX4.step_s, STOP_S])
    commands = [0.0, 0.0, 0.0, 1j * PX4.step_m_s, -1j * PX4.step_m_s, 0.0]
    places, speeds = [], []
    for number, (command, steps) in enumerate(
        zip(commands, np.diff(ends, prepend=0.0) / STEP_S, strict=True)
    ):
        for _ in range(round(steps)):
            wanted = -HOLD_1_S * x if number == 0 else command * obeys
            error = wanted - v
            integral = integral + I_1_S2 * error * STEP_S
            thrust = thrust + (P_1_S * error + integral - thrust) * STEP_S / THRUST_LAG_S
            v = v + (thrust + DRAG_1_S * (gusts.next() - v)) * STEP_S
            x = x + v * STEP_S
        places.append(x)
        speeds.append(np.abs(v))
    _, begun, held, turned, back, _ = places
    moved_m = (2.0 * turned - held - back).imag / 2.0
    return np.abs(held - begun), moved_m / (PX4.step_m_s * PX4.step_s), speeds[2], speeds[5]


@pytest.fixture(scope="module")
def following():
    return flown(obeys=1.0)


def test_999_of_1000_flights_of_px4s_loop_are_within_them(following):
    drift_m, share, hold_m_s, stop_m_s = following
    least, most = PX4.moved_share
    assert np.quantile(drift_m, 0.999) < PX4.drift_m
    assert np.quantile(share, 0.001) > least
    assert np.quantile(share, 0.999) < most
    assert np.quantile(hold_m_s, 0.999) < PX4.still_m_s
    assert np.quantile(stop_m_s, 0.999) < PX4.still_m_s


def test_a_limit_of_half_the_drift_would_fail_one_flight_in_a_hundred(following):
    assert np.quantile(following[0], 0.99) > PX4.drift_m / 2.0


@pytest.mark.parametrize("obeys", [0.0, -1.0])
def test_a_vehicle_that_does_not_follow_is_found(obeys):
    share = flown(obeys)[1]
    assert np.quantile(share, 0.999) < PX4.moved_share[0]
