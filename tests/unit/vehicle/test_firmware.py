"""Controllers, mixer, supervisor and estimator of the firmware model."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flightstack.compiled.records import new
from sim.firmware.estimator import ACCEL_XY_M_S2, ACCEL_Z_M_S2, Estimator, axis_gains, predict
from sim.firmware.mixer import MapRecord, mix, motor_speed, set_up_map
from sim.plant.params import CONTROL_STEP_S, STEP_S, Plant, load
from sim.plant.rotation import rotation_axes
from sim.plant.rotors import Rotors, turn_rotors
from sim.scenarios.scenario import OdometryLink, VehicleSpec, VelocityLoop, Wind
from tests.unit.vehicle.vehicle_sim_helpers import fly, vehicle

PARAMS = load()
WEIGHT = PARAMS.body.mass_kg * PARAMS.contact.gravity_m_s2
HOVER_COUNTS = WEIGHT / 4.0 / 0.12 * 65535.0
LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NO_RATES = (0.0, 0.0, 0.0)


def speeds_of(counts, rpm_max=1e9):
    thrust_map = set_up_map(new(MapRecord), PARAMS.rotor, PARAMS.battery)
    return [motor_speed(thrust_map, c, rpm_max) for c in counts]


def turned_at(speeds):
    """Return the wrench of rotors at these speeds."""
    rotors = Rotors(PARAMS.rotor, Plant(), False, STEP_S)
    rotors.rpm = speeds
    turn_rotors(rotors.record, np.array(speeds), 0.0, 0.0)
    return rotors.record


class TestMixer:
    @pytest.mark.parametrize(("axis", "torque"), [(0, "torque_x"), (1, "torque_y"), (2, "torque_z")])
    def test_a_positive_moment_turns_the_body_positively_and_nothing_else(self, axis, torque):
        moments = [0, 0, 0]
        moments[axis] = 2000
        speeds = speeds_of(mix(HOVER_COUNTS, tuple(moments)))
        rotors = turned_at(speeds)
        assert getattr(rotors, torque) > 0.0
        for other in {"torque_x", "torque_y", "torque_z"} - {torque}:
            assert abs(getattr(rotors, other)) < 0.02 * getattr(rotors, torque) + 1e-12
        assert rotors.thrust_n == pytest.approx(WEIGHT, rel=1e-6)

    def test_below_the_smallest_thrust_a_motor_stops(self):
        least = 0.0128 / 0.12 * 65535.0
        assert speeds_of((least - 1.0, least + 1.0, 0.0, 0.0))[0] == 0.0
        assert PARAMS.rotor.thrust_n(speeds_of((0.0, least + 1.0, 0.0, 0.0))[1]) > 0.0128

    def test_counts_are_linear_in_thrust_and_the_battery_caps_the_speed(self):
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
        assert max(abs(poles)) < math.exp(-t / 2.0)  # decays within 2 s
        velocity, walk = accel**2 * 1e-3, (9.81 * 0.1) ** 2 * 1e-3
        q = velocity * np.array([[t**3 / 3, t**2 / 2, 0], [t**2 / 2, t, 0], [0, 0, 0]]) + walk * np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        p = scipy_linalg.solve_discrete_are(f.T, np.array([[1.0], [0.0], [0.0]]), q, np.array([[1e-4]]))
        assert k == pytest.approx(p[:, 0] / (p[0, 0] + 1e-4), rel=1e-6)

    def test_integrates_the_gyro_and_the_accelerometer(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        for _ in range(500):
            predict(estimator.record, np.array((0.0, 0.0, 1.0)), np.array((0.0, 0.0, 9.81 + 0.5)))
        sensed = estimator.sensed
        assert math.atan2(sensed.axes[1], sensed.axes[0]) == pytest.approx(1.0, abs=1e-4)
        assert sensed.velocity == pytest.approx((0.0, 0.0, 0.5), abs=1e-9)
        assert sensed.position == pytest.approx((0.0, 0.0, 0.25), abs=1e-9)

    @pytest.mark.parametrize("start", [(0.05, 0.0), (0.0, -0.05)])
    def test_a_wrong_tilt_is_found_from_position(self, start):
        roll, pitch = start
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        half = 0.5 * (roll or pitch)
        tilted = (math.cos(half), math.sin(half) if roll else 0.0, math.sin(half) if pitch else 0.0, 0.0)
        estimator.settle((0.0, 0.0, 1.0), NO_RATES, rotation_axes(tilted), tilted, [0.0, 0.0, 0.0])
        for k in range(5000):
            predict(
                estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81))
            )  # the true state is level and at rest
            if k % 5 == 0:
                estimator.correct(0.0, 0.0, 1.0, 0.0)
        assert estimator.sensed.axes[6:8] == pytest.approx((0.0, 0.0), abs=1e-4)
        assert estimator.sensed.velocity == pytest.approx(NO_RATES, abs=1e-4)

    def test_a_late_capture_makes_the_position_late_and_the_velocity_right(self):
        estimator = Estimator(0.01, CONTROL_STEP_S, 9.81)
        speed, delay = 1.0, 0.02
        estimator.settle((0.0, 0.0, 1.0), (speed, 0.0, 0.0), LEVEL, (1.0, 0.0, 0.0, 0.0), [0.0, 0.0, 0.0])
        for k in range(1, 5001):
            predict(estimator.record, np.array(NO_RATES), np.array((0.0, 0.0, 9.81)))
            if k % 5 == 0:
                estimator.correct(speed * (k * CONTROL_STEP_S - delay), 0.0, 1.0, 0.0)
        assert estimator.sensed.position[0] == pytest.approx(speed * (10.0 - delay), abs=1e-4)
        assert estimator.sensed.velocity[0] == pytest.approx(speed, abs=1e-4)


CLEAN = OdometryLink(100.0)


def flown(known_drag_1_s, wind_m_s=0.0, mocap=CLEAN):
    spec = VehicleSpec(mocap=mocap, velocity_loop=VelocityLoop.PID, known_drag_1_s=known_drag_1_s)
    sim = vehicle(vehicle=spec, wind=Wind(wind_m_s, 0.0, 0.0))
    fly(sim, (0.3, 0.0, 0.0), 6.0)
    return sim


@pytest.mark.parametrize(
    ("known_drag_1_s", "ratio"), [(None, 1.0), ((0.0, 0.0, 0.0), 1.162), ((0.46, 0.46, 0.4), 1.0)]
)
def test_its_velocity_is_too_high_by_the_drag_that_it_does_not_know(known_drag_1_s, ratio):
    sim = flown(known_drag_1_s)
    true_m_s, told_m_s = sim.truth().velocity_enu_m_s[0], sim.estimate().velocity_enu_m_s[0]
    assert told_m_s / true_m_s == pytest.approx(ratio, abs=0.006)


def test_a_known_drag_does_not_help_against_wind():
    sim = flown((0.46, 0.46, 0.4), wind_m_s=1.0)
    assert sim.truth().velocity_enu_m_s[0] - sim.estimate().velocity_enu_m_s[0] == pytest.approx(
        0.14, abs=0.03
    )


@pytest.mark.parametrize("tilt_rad", [0.0, 0.0175])
def test_poses_from_outside_whose_markers_are_tilted_make_it_drift(tilt_rad):
    silent = OdometryLink(100.0, loss=1.0)
    spec = VehicleSpec(mocap=silent, velocity_loop=VelocityLoop.PID, known_drag_1_s=(0.46, 0.46, 0.4))
    sim = vehicle(vehicle=spec)
    for _ in range(500):
        truth = sim.truth()
        w, x, y, z = truth.quaternion
        half = 0.5 * tilt_rad  # about y
        sim.take_pose(truth.position_enu_m, (w - half * y, x - half * z, y + half * w, z + half * x))
        sim.set_velocity((0.0, 0.0, 0.0), 0.0)
        sim.advance(10)
    drift_m_s = 0.068 if tilt_rad else 0.0  # measured on firmware 2026.08, for a degree
    assert -sim.truth().velocity_enu_m_s[0] == pytest.approx(drift_m_s, abs=0.01)
