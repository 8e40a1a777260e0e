"""The estimator in the firmware's form: body z alone in flight, drag by parameter, whole poses."""

from __future__ import annotations

import pytest

from sim.scenarios.scenario import OdometryLink, VehicleSpec, VelocityLoop, Wind
from tests.unit.vehicle.vehicle_sim_helpers import fly, vehicle

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
