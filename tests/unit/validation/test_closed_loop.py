"""Tests flights of the simulated vehicle with the recorded set-points of simulated and real flights."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sim.flights.recording import Recording
from sim.flights.screening import screen
from sim.plant.params import Plant, TorqueNoiseShape, load
from sim.scenarios.tables import Start, StartKind, StateError, VehicleSpec, VelocityLoop
from sim.validation.closed_loop import fly
from sim.vehicle.vehicle import VehicleSim
from tests.unit.vehicle.vehicle_sim_helpers import scenario

ROOM = replace(load("crazyflie21_room"), torque_noise=TorqueNoiseShape())  # without random torques
MARKERS_M = 0.04  # height of the tracked point above the centre of mass
GROUND_TICKS, UP_TICKS, TICKS = 100, 500, 2000


def setpoint(tick):
    """Return a position set-point: a climb to 1 m in 2 s, then circles of 0.8 m radius at 0.6 m/s."""
    height = min(1.0, 0.05 + (tick - GROUND_TICKS) / 200.0)
    angle = 0.75 * max(0.0, (tick - UP_TICKS) / 100.0)
    return (3.0 + 0.8 * math.sin(angle), 0.8 - 0.8 * math.cos(angle), height)


@cache
def recorded(plant: Plant):
    """Return a simulated flight as a ``Recording``, with the columns of a real flight."""
    spec = VehicleSpec("crazyflie21_room", VelocityLoop.PID, own=StateError())
    start = Start(StartKind.GROUND, ground_position_m=(3.0, 0.0))
    sim = VehicleSim(scenario(start=start, vehicle=spec), 5, ROOM, plant)
    bodies, duties, volts, setpoints = [], [], [], []
    for tick in range(TICKS):
        if tick == GROUND_TICKS:
            assert sim.arm() is None
        if tick >= GROUND_TICKS:
            sim.set_position(setpoint(tick), 0.0)
        sim.advance(10)
        bodies.append(np.concatenate(sim.body()))
        duties.append(sim.duty)
        volts.append(sim.battery_v)
        setpoints.append(setpoint(tick) if tick >= GROUND_TICKS else (0.0, 0.0, 0.0))
    body, higher = np.array(bodies), np.array((0.0, 0.0, MARKERS_M))
    setpoints = np.array(setpoints)
    setpoints[GROUND_TICKS:] += higher
    return Recording(
        "made", 0.01 * np.arange(TICKS), body[:, :3] + higher, body[:, 3:6], body[:, 6:10], body[:, 10:13],
        np.array(duties), np.array(volts), setpoint_position_m=setpoints, setpoint_yaw_rad=np.zeros(TICKS),
        thrust_command=np.full(TICKS, 0.5),
    )  # fmt: skip


AIRFRAME = Plant(motors=(0.93, 1.02, 1.0, 1.05), thrust=0.97, battery_charge=0.6)


def test_the_simulators_own_flight_is_found_again():
    found = fly(screen(recorded(AIRFRAME)), ROOM, 0)
    assert found is not None
    assert found.thrust == pytest.approx(0.97, abs=0.01)
    a, b = found.recorded, found.simulated
    assert a.horizontal_m > 0.2  # at 0.6 m/s the vehicle follows about half a second late
    assert b.horizontal_m == pytest.approx(a.horizontal_m, rel=0.15)
    assert b.vertical_m == pytest.approx(a.vertical_m, abs=0.02)
    assert b.duty == pytest.approx(a.duty, rel=0.01)


def test_a_tired_battery_saturates_in_both():
    full, tired = (
        fly(screen(recorded(replace(AIRFRAME, battery_charge=charge))), ROOM, 0) for charge in (0.6, 0.03)
    )
    assert full.recorded.saturated == full.simulated.saturated == 0.0
    assert tired.recorded.saturated > 0.02
    assert 0.5 < tired.simulated.saturated / tired.recorded.saturated < 2.0


def test_the_thrust_factor_shows_a_vehicle_file_with_a_wrong_mass():
    """With a vehicle file that is 10 % too heavy, the thrust factor of the flight is 10 % larger."""
    weak = replace(ROOM, body=replace(ROOM.body, mass_kg=1.1 * ROOM.body.mass_kg))
    assert fly(screen(recorded(AIRFRAME)), weak, 0).thrust == pytest.approx(1.1 * 0.97, abs=0.01)


@pytest.mark.parametrize(
    "change",
    [
        {"setpoint_position_m": None},
        {"thrust_command": np.zeros(TICKS)},
        {"setpoint_position_m": np.zeros((TICKS, 3))},
        {"setpoint_position_m": np.full((TICKS, 3), np.nan)},
        {"setpoint_position_m": np.ones((TICKS, 3)), "duty": np.full((TICKS, 4), 0.8)},
    ],
    ids=["no column", "another controller", "none sent", "not a number", "begins in the air"],
)
def test_without_set_points_from_the_ground_on_nothing_is_flown(change):
    assert fly(screen(replace(recorded(AIRFRAME), **change)), ROOM, 0) is None
