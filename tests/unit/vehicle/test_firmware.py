"""Tests the firmware model: controllers, mixer, supervisor, estimator, and errors of its state."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.clock import TickGrid
from sim.firmware.estimator import ACCEL_XY_M_S2, ACCEL_Z_M_S2, axis_gains
from sim.firmware.mixer import MapRecord, motor_speed, set_up_map
from sim.plant.params import load
from sim.runners.robot import Robot
from sim.scenarios.tables import OdometryLink, PathKind, TargetLink, TargetSpec, VehicleSpec, VelocityLoop
from tests.crazyflie_firmware.sim_plant import take_pose
from tests.unit.plant.test_state_error import FINE
from tests.unit.vehicle.vehicle_sim_helpers import scenario, vehicle

PARAMS = load()


def speeds_of(counts, rpm_max=1e9):
    thrust_map = set_up_map(new(MapRecord), PARAMS.rotor, PARAMS.battery)
    return [motor_speed(thrust_map, c, rpm_max) for c in counts]


def test_below_the_smallest_thrust_a_motor_stops():
    least = 0.0128 / 0.12 * 65535.0
    assert speeds_of((least - 1.0, least + 1.0, 0.0, 0.0))[0] == 0.0
    assert PARAMS.rotor.thrust_n(speeds_of((0.0, least + 1.0, 0.0, 0.0))[1]) > 0.0128


def test_counts_are_linear_in_thrust_and_the_battery_caps_the_speed():
    for counts in (10000.0, 42000.0, 65535.0):
        rpm = speeds_of((counts,) * 4)[2]
        assert PARAMS.rotor.thrust_n(rpm) == pytest.approx(0.12 * counts / 65535.0, rel=1e-12)
    assert speeds_of((65535.0,) * 4, 20000.0) == [20000.0] * 4


class TestEstimator:
    @pytest.mark.parametrize("rate_hz", [50.0, 100.0])
    @pytest.mark.parametrize("accel", [ACCEL_XY_M_S2, ACCEL_Z_M_S2])
    def test_gains_are_the_kalman_filters_and_stable(self, rate_hz, accel):
        scipy_linalg = pytest.importorskip("scipy.linalg")
        t = 1.0 / rate_hz
        k = np.array(axis_gains(t, accel, 9.81))
        f = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
        poles = np.linalg.eigvals((np.eye(3) - np.outer(k, [1.0, 0.0, 0.0])) @ f)
        assert max(abs(poles)) < math.exp(-t / 2.0)  # errors decay with a time constant below 2 s
        velocity, walk = accel**2 * 1e-3, (9.81 * 0.1) ** 2 * 1e-3
        q = velocity * np.array([[t**3 / 3, t**2 / 2, 0], [t**2 / 2, t, 0], [0, 0, 0]]) + walk * np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        p = scipy_linalg.solve_discrete_are(f.T, np.array([[1.0], [0.0], [0.0]]), q, np.array([[1e-4]]))
        assert k == pytest.approx(p[:, 0] / (p[0, 0] + 1e-4), rel=1e-6)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.0175])
def test_poses_from_outside_whose_markers_are_tilted_make_it_drift(tilt_rad):
    silent = OdometryLink(100.0, loss=1.0)
    spec = VehicleSpec(mocap=silent, velocity_loop=VelocityLoop.PID, known_drag_1_s=(0.46, 0.46, 0.4))
    sim = vehicle(vehicle=spec)
    for _ in range(500):
        truth = sim.truth()
        x, y, z, w = truth.orientation
        half = 0.5 * tilt_rad  # half of the angle of a rotation about y
        q = (w - half * y, x - half * z, y + half * w, z + half * x)
        take_pose(sim, truth.position_enu_m, q)
        sim.set_velocity((0.0, 0.0, 0.0), 0.0)
        sim.advance(10)
    drift_m_s = 0.068 if tilt_rad else 0.0  # measured on firmware 2026.08 with a tilt of one degree
    assert -sim.truth().velocity_enu_m_s[0] == pytest.approx(drift_m_s, abs=0.01)


def driven(error, seed=1):
    """Return position, velocity and heading of a robot on a circle at each tick, and its odometry samples."""
    spec = TargetSpec(PathKind.CIRCLE, 0.2, 0.5, wait_for_landing=False)
    robot = Robot(scenario(target=spec, odometry=TargetLink(error=error)), seed, TickGrid(100))
    first = robot.first_tick()
    later = robot.run(600, True)
    truth = later.pads[:, [1, 2, 3, 5, 6, 7, 4]]  # position, velocity in the body frame, heading
    return truth, [*first.samples.tolist(), *later.samples.tolist()]


def test_vehicle_and_target_may_share_the_delay_of_the_capture():
    base = replace(FINE, delay_s=0.02, delay_spread_s=0.02, delay_shared=True)
    for seed in (1, 2):
        truth, samples = driven(base, seed)
        ahead = np.array(samples[-1][1:4]) - truth[-1, :3]
        speed = np.linalg.norm(truth[-1, 3:6])
        own_s = vehicle(seed, vehicle=VehicleSpec(own=base))._mocap._error_rows[0, 0]
        assert np.linalg.norm(ahead) / speed == pytest.approx(abs(own_s), abs=1e-3)
