"""The simulated vehicle and the deck: contact, friction, first touch."""

import math

import pytest

from sim.robot.target import TargetModel
from sim.scenarios.scenario import (
    PathKind,
    TargetSpec,
)
from sim.vehicle.vehicle import CONTACT_GROUND, CONTACT_PAD, CONTACT_ROBOT, CONTACT_TUMBLED
from tests.unit.vehicle.vehicle_sim_helpers import (
    STANDING,
    vehicle,
)


def ride(spec, offset, seconds, seed=1):
    """Hover over a driving target at its speed, cut the motors, and follow the target."""
    target = TargetModel(spec, seed)
    for _ in range(300):
        target.step(0.01, True)
    sim = vehicle(seed, target=spec)
    pad, v = target.pose.position_enu_m, target.velocity_enu_m_s
    sim._world.set_vehicle(tuple(p + o for p, o in zip(pad, offset, strict=True)), velocity=v)
    sim.disarm(force=True)
    truths = []
    for _ in range(round(seconds * 100)):
        sim.set_deck(
            target.pose.position_enu_m, target.pose.yaw_rad, target.velocity_enu_m_s, target.yaw_rate_rad_s
        )
        sim.advance(10)
        target.step(0.01, True)
        truths.append(sim.truth())
    return sim, truths


def test_deck_of_the_simulation_and_the_target_agree_between_updates():
    spec = TargetSpec(
        path=PathKind.REVERSING, speed_m_s=0.2, turn_rate_rad_s=0.5, heave_amplitude_m=0.1, heave_rate_hz=0.3
    )
    target, sim = TargetModel(spec, 1), vehicle(target=spec)
    for _ in range(500):
        sim.set_deck(
            target.pose.position_enu_m, target.pose.yaw_rad, target.velocity_enu_m_s, target.yaw_rate_rad_s
        )
        sim.advance(10)
        target.step(0.01, True)
        assert sim.truth().pad_position_enu_m == pytest.approx(target.pose.position_enu_m, abs=1e-9)


def test_a_drop_from_3_cm_onto_a_driving_pad_stays_and_travels():
    spec = TargetSpec(path=PathKind.CIRCLE, speed_m_s=0.1, turn_rate_rad_s=0.1)
    sim, truths = ride(spec, (0.01, 0.02, STANDING + 0.03), 3.5)
    touched = next(i for i, t in enumerate(truths) if t.contacts)
    assert {t.contacts for t in truths[touched:]} == {CONTACT_PAD}
    assert all(t.contacts == 0 for t in truths[:touched])
    assert sim.on_pad
    assert sim.landed
    assert not sim.on_ground
    last = truths[-1]
    e = [a - b for a, b in zip(last.position_enu_m, last.pad_position_enu_m, strict=True)]
    assert math.hypot(*e) < 0.04
    assert e[2] == pytest.approx(STANDING, abs=1e-4)
    assert last.velocity_enu_m_s == pytest.approx(last.pad_velocity_enu_m_s, abs=5e-3)
    travelled = math.dist(last.position_enu_m, truths[touched].position_enu_m)
    assert travelled == pytest.approx(0.1 * 0.01 * (len(truths) - touched), rel=0.05)


def test_first_touch_is_the_state_before_the_impact():
    sim, truths = ride(TargetSpec(path=PathKind.STRAIGHT, speed_m_s=0.2), (0.03, 0.0, STANDING + 0.03), 1.0)
    first = next(t for t in truths if t.contacts)
    touch = truths[-1]
    assert first.first_touch_time_s == touch.first_touch_time_s
    assert touch.time_s - 1.0 < touch.first_touch_time_s < first.time_s
    assert touch.first_touch_relative_position_enu_m == pytest.approx((0.03, 0.0, STANDING), abs=2e-3)
    vx, vy, vz = touch.first_touch_relative_velocity_enu_m_s
    assert abs(vx) < 0.02
    assert abs(vy) < 0.02
    # at most the free fall from 3 cm; the rotors still run down
    assert -math.sqrt(2 * 9.81 * 0.031) < vz < -0.6
    sim.begin_judging()
    assert math.isnan(sim.truth().first_touch_time_s)
    sim.advance(1)
    assert sim.truth().first_touch_time_s == pytest.approx(sim.time_s - 0.001)


def test_missing_the_pad_touches_other_things():
    _, truths = ride(TargetSpec(), (0.115, 0.0, STANDING + 0.05), 1.5)
    seen = 0
    for t in truths:
        seen |= t.contacts
    assert seen & CONTACT_GROUND
    assert seen & (CONTACT_ROBOT | CONTACT_TUMBLED)
