"""Vehicle and target states with errors of recorded flights, and results that stay equal without them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.clock import TickGrid
from sim.plant.state_error import TURN
from sim.robot.target_motion import TargetMotion
from sim.scenarios.fault_spec import Fault, Kind, What
from sim.scenarios.scenario import PathKind, TargetLink, TargetSpec, VehicleSpec
from tests.unit.plant.test_state_error import FINE
from tests.unit.vehicle.vehicle_sim_helpers import QUIET, scenario, vehicle


def flown(error, *, seconds=4.0, seed=1, mocap=QUIET, fault=(), speed=0.5):
    """Return true states and estimates at 100 Hz of a vehicle that flies a circle."""
    sim = vehicle(seed, vehicle=VehicleSpec(mocap=mocap, own=error), fault=fault)
    pairs = []
    for k in range(round(100 * seconds)):
        angle = 0.02 * k
        sim.set_velocity((speed * math.cos(angle), speed * math.sin(angle), 0.0), 0.0)
        sim.advance(10)
        pairs.append((sim.truth(), sim.estimate()))
    return pairs


def arrays(pairs):
    """Return true and estimated positions and velocities, each (n, 6)."""
    truth = [(*t.position_enu_m, *t.velocity_enu_m_s) for t, _ in pairs]
    belief = [(*e.position_enu_m, *e.velocity_enu_m_s) for _, e in pairs]
    return np.array(truth), np.array(belief)


def test_an_estimate_without_errors_is_the_truth():
    truth, belief = arrays(flown(FINE))
    # the newest sample is one step old, for which the accelerometer's bias acts
    assert np.abs(truth - belief)[:, :3].max() < 1e-3
    assert np.abs(truth - belief)[:, 3:].max() < 0.02


@pytest.mark.parametrize("delay_s", [0.05, 0.1])
def test_an_estimate_is_late_by_the_delay(delay_s):
    truth, belief = arrays(flown(replace(FINE, delay_s=delay_s)))
    steps = round(100 * delay_s)
    late = (truth[:-steps] - belief[steps:])[50:]
    assert np.abs(late[:, :3]).max() < 3e-3
    assert np.abs(late[:, 3:]).max() < 0.1
    assert np.abs(truth - belief)[100:, :3].max() > 0.5 * 0.5 * delay_s


def test_the_attitude_is_off_by_the_misalignment_and_no_more():
    turned = replace(FINE, tilt_rad=0.03, yaw_rad=0.05)
    pairs = flown(turned, seed=3)
    axes = [np.array(pair[1].quaternion) for pair in pairs]
    true = [np.array(pair[0].quaternion) for pair in pairs]
    angles = [2.0 * math.acos(min(1.0, abs(float(a @ b)))) for a, b in zip(axes, true, strict=True)]
    sim = vehicle(3, vehicle=VehicleSpec(mocap=QUIET, own=turned))
    expected = float(np.linalg.norm(sim._mocap._error_rows[0, TURN:]))
    assert expected > 0.01
    assert angles[50:] == pytest.approx([expected] * len(angles[50:]), abs=0.006)


def test_a_fault_of_motion_capture_works_on_the_samples_with_their_errors():
    shift = Fault(What.MOCAP, Kind.WRONG, start_s=1.0, duration_s=2.0, offset_m=(0.3, 0.0, 0.0))
    truth, belief = arrays(flown(replace(FINE, delay_s=0.05), fault=(shift,)))
    assert (belief - truth)[250:300, 0].mean() == pytest.approx(0.3, abs=0.06)
    late = truth[330:-5] - belief[335:]
    assert np.abs(late[:, :3]).max() < 3e-3


def driven(error, seed=1):
    """Return samples of a robot on a circle, and its true position, velocity (ENU) and heading at
    each tick."""
    spec = TargetSpec(PathKind.CIRCLE, 0.2, 0.5, wait_for_landing=False)
    motion = TargetMotion(scenario(target=spec, odometry=TargetLink(error=error)), seed, TickGrid(100))
    truth, samples = [], []
    for _ in range(600):
        motion.step(True)
        model = motion.model
        truth.append((*model.pose.position_enu_m, *model.velocity_body_m_s, model.pose.yaw_rad))
        due, motion.due = motion.due, []
        samples += due
    return np.array(truth), samples


@pytest.mark.parametrize("delay_s", [0.05, 0.1])
def test_samples_of_the_target_are_late_by_the_delay_and_stamped_as_if_not(delay_s):
    truth, samples = driven(replace(FINE, delay_s=delay_s))
    steps = round(100 * delay_s)
    measured = np.array([(*s.position_enu_m, *s.velocity_body_m_s, s.yaw_rad) for s in samples[-600:]])
    assert samples[-1].time_s == pytest.approx(6.0)
    late = (measured[steps:] - truth[:-steps])[100:]
    assert np.abs(late[:, :6]).max() < 1e-4
    assert np.abs(late[:, 6]).max() < 1e-3


def test_vehicle_and_target_may_share_the_delay_of_the_capture():
    base = replace(FINE, delay_s=0.02, delay_spread_s=0.02, delay_shared=True)
    for seed in (1, 2):
        truth, samples = driven(base, seed)
        ahead = np.array(samples[-1].position_enu_m) - truth[-1, :3]
        speed = np.linalg.norm(truth[-1, 3:6])
        own_s = vehicle(seed, vehicle=VehicleSpec(own=base))._mocap._error_rows[0, 0]
        assert np.linalg.norm(ahead) / speed == pytest.approx(abs(own_s), abs=1e-3)
