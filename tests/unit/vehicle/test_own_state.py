"""Tests states of vehicle and target with errors as in recorded flights, and results without errors."""

from dataclasses import replace

import numpy as np
import pytest

from sim.clock import TickGrid
from sim.runners.robot import TargetMotion
from sim.scenarios.tables import PathKind, TargetLink, TargetSpec, VehicleSpec
from tests.unit.plant.test_state_error import FINE
from tests.unit.vehicle.vehicle_sim_helpers import scenario, vehicle


def driven(error, seed=1):
    """Return samples of a robot on a circle, and its true position, velocity (ENU) and heading, by tick."""
    spec = TargetSpec(PathKind.CIRCLE, 0.2, 0.5, wait_for_landing=False)
    motion = TargetMotion(scenario(target=spec, odometry=TargetLink(error=error)), seed, TickGrid(100))
    truth, samples = [], motion.first[2].tolist()
    for _ in range(600):
        samples += motion.run(1, True)[2].tolist()
        model = motion.model
        truth.append((*model.pose.position_enu_m, *model.velocity_body_m_s, model.pose.yaw_rad))
    return np.array(truth), samples


def test_vehicle_and_target_may_share_the_delay_of_the_capture():
    base = replace(FINE, delay_s=0.02, delay_spread_s=0.02, delay_shared=True)
    for seed in (1, 2):
        truth, samples = driven(base, seed)
        ahead = np.array(samples[-1][1:4]) - truth[-1, :3]
        speed = np.linalg.norm(truth[-1, 3:6])
        own_s = vehicle(seed, vehicle=VehicleSpec(own=base))._mocap._error_rows[0, 0]
        assert np.linalg.norm(ahead) / speed == pytest.approx(abs(own_s), abs=1e-3)
