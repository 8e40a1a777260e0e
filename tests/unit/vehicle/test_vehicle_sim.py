"""Tests the whole vehicle: hover, steps, watchdog, landing on a driving pad, determinism."""

import math

import pytest

from flightstack.core.safety.barrier import Barrier
from sim.scenarios.tables import OdometryLink, Start, StartKind, TargetSpec, VehicleSpec, Wind
from tests.unit.vehicle.vehicle_sim_helpers import LOOPS, QUIET, STANDING, fly, vehicle


@pytest.mark.parametrize("loop", LOOPS)
def test_takes_off_from_the_ground_and_lands_on_it(loop):
    start = Start(ground_position_m=(-1.2, 0.3))
    sim = vehicle(vehicle=VehicleSpec(velocity_loop=loop, mocap=QUIET), start=start)
    assert (sim.armed, sim.on_ground, sim.landed, sim.on_pad, sim.motors_running) == (
        False,
        True,
        True,
        False,
        False,
    )
    fly(sim, (0.0, 0.0, 0.3), 0.5)
    assert sim.truth().position_enu_m == pytest.approx((-1.2, 0.3, STANDING), abs=1e-4)  # disarmed vehicle
    assert sim.arm() is None
    assert sim.arm() is None
    sim.advance(100)
    assert not sim.motors_running  # no set-point has arrived since the vehicle was armed
    truths = fly(sim, (0.0, 0.0, 0.3), 2.0)
    assert truths[-1].position_enu_m[2] > 0.2
    assert not sim.on_ground
    assert not sim.landed
    refused = sim.disarm(force=False)
    assert refused is not None
    assert "in the air" in refused
    truths = fly(sim, (0.0, 0.0, -0.2), 4.0)
    assert sim.landed
    assert sim.on_ground
    assert math.isnan(truths[-1].first_touch_time_s)  # contact with the floor is no contact with the pad
    assert sim.disarm(force=False) is None
    sim.advance(1000)
    assert not sim.armed
    assert not sim.motors_running
    assert math.hypot(*sim.truth().velocity_enu_m_s) < 1e-6


def test_truth_accumulates_between_calls():
    sim = vehicle(start=Start(StartKind.HOVER, offset_m=(0.05, 0.0, 0.5)))
    barrier = Barrier(1.0, 1.5)
    lowest, outside = math.inf, math.inf
    sim.truth()
    for _ in range(600):
        sim.set_velocity((0.3, 0.0, -0.1), 0.0)
        sim.advance(1)
        t = sim.truth()
        e = tuple(a - b for a, b in zip(t.position_enu_m, t.pad_position_enu_m, strict=True))
        assert t.h_m == pytest.approx(barrier.h(e), abs=1e-12)
        assert t.h_min_m == t.h_m
        lowest = min(lowest, t.h_m)
        outside = min(outside, t.h_min_outside_pad_m)
        assert math.isfinite(t.h_min_outside_pad_m) is (math.hypot(e[0], e[1]) > 0.1)
    again = vehicle(start=Start(StartKind.HOVER, offset_m=(0.05, 0.0, 0.5)))
    for _ in range(600):
        again.set_velocity((0.3, 0.0, -0.1), 0.0)
        again.advance(1)
    t = again.truth()
    assert t.h_min_m == lowest
    assert t.h_min_outside_pad_m == outside


def noisy():
    mocap = OdometryLink(100.0, 0.005, 0.0, 0.005, 0.02, loss=0.02)
    spec = VehicleSpec(mocap=mocap, mass_spread=0.1, motor_lag_spread=0.3, thrust_spread=0.1)
    start = Start(StartKind.HOVER, distance_m=(0.3, 2.5), h_m=(0.1, 1.2))
    return {
        "vehicle": spec,
        "wind": Wind(1.0, 0.6),
        "start": start,
        "target": TargetSpec(random_heading=True),
    }


def test_chunks_of_advance_do_not_matter():
    a, b = vehicle(5, **noisy()), vehicle(5, **noisy())
    for _ in range(30):
        a.advance(10)
    for _ in range(20):
        b.advance(15)
    assert repr(a.truth()) == repr(b.truth())


def test_a_vehicle_that_is_locked_after_a_flight_refuses_to_arm():
    sim = vehicle()
    fly(sim, (0.0, 0.0, 0.0), 0.5)
    sim.advance(2600)
    assert sim.locked
    assert "reboot" in sim.arm()


def test_blind_vehicle_refuses_to_arm():
    spec = VehicleSpec(mocap=OdometryLink(100.0, loss=1.0))
    sim = vehicle(vehicle=spec, start=Start())
    sim.advance(600)
    assert not sim.estimate().valid
    assert sim.arm() == "no motion-capture samples"
