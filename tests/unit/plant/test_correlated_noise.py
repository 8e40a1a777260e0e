"""Torque noise of a vehicle: size and correlation time, when it is off, and its effect in flight."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.plant.correlated_noise import CorrelatedNoise, vary
from sim.plant.params import Plant, TorqueNoiseShape, load
from sim.scenarios.scenario import Start, StartKind, VehicleSpec, VelocityLoop
from sim.vehicle.vehicle import VehicleSim
from tests.unit.vehicle.vehicle_sim_helpers import QUIET, scenario

STEP_S = 0.005
SHAPE = TorqueNoiseShape((4e-5, 2e-5, 0.0), (0.1, 0.25, 1.0))
ROOM = load("crazyflie21_room")


def drawn(seed, steps=20_000):
    noise = CorrelatedNoise(SHAPE.rms_n_m, SHAPE.time_s, seed, "torque.noise", STEP_S)
    out = np.empty((steps, 3))
    for k in range(steps):
        noise.top_up()
        vary(noise.record)
        out[k] = noise.record.now
    return out


def test_each_axis_has_its_size_and_its_time():
    torque = np.concatenate([drawn(seed) for seed in range(3)])
    assert torque.std(axis=0)[:2] == pytest.approx(SHAPE.rms_n_m[:2], rel=0.05)
    assert not torque[:, 2].any()
    for axis in (0, 1):
        lag = round(SHAPE.time_s[axis] / STEP_S)
        together = float(np.mean(torque[lag:, axis] * torque[:-lag, axis]) / np.mean(torque[:, axis] ** 2))
        assert together == pytest.approx(math.exp(-1.0), abs=0.06)
    assert abs(np.corrcoef(torque[:, 0], torque[:, 1])[0, 1]) < 0.05


def hovering(params):
    """Return rates and motor differences in hover."""
    spec = VehicleSpec("crazyflie21_room", VelocityLoop.PID, mocap=QUIET)
    sim = VehicleSim(scenario(vehicle=spec), 3, params, Plant())
    rates, roll = [], []
    for _ in range(500):
        sim.set_velocity((0.0, 0.0, 0.0), 0.0)
        sim.advance(10)
        rates.append(sim.body()[10:])
        m1, m2, m3, m4 = sim.duty
        roll.append((m3 + m4 - m1 - m2) / 4.0)
    return np.std(rates, axis=0), float(np.std(roll))


def test_in_flight_the_motors_balance_it():
    """4.5e-5 N m are 0.25 % of the duty cycle: the motors show it within the loop's bandwidth."""
    still = replace(ROOM, torque_noise=TorqueNoiseShape())
    (quiet_rates, quiet_roll), (rates, roll) = hovering(still), hovering(ROOM)
    assert (rates[:2] > 1.5 * quiet_rates[:2]).all()
    assert rates[0] < 0.2
    assert 0.001 < math.sqrt(roll**2 - quiet_roll**2) < 0.005


def standing(params):
    """Return the position of a vehicle after a second on the floor, motors off."""
    spec = VehicleSpec("crazyflie21_room", VelocityLoop.PID, mocap=QUIET)
    start = Start(StartKind.GROUND, ground_position_m=(3.0, 0.0))
    sim = VehicleSim(scenario(start=start, vehicle=spec), 3, params, Plant())
    sim.advance(1000)
    return sim.body()


def test_a_vehicle_that_stands_is_left_alone():
    assert standing(ROOM) == standing(replace(ROOM, torque_noise=TorqueNoiseShape()))
