"""Rigid body, deck and contact."""

import math

import pytest

from sim.compiled.rotation import quaternion_from_axes, rotation_axes
from sim.plant.params import STEP_S, load
from sim.scenarios.scenario import TargetSpec
from sim.world.contact import ContactBit
from sim.world.world import World

PARAMS = load()
MASS = PARAMS.body.mass_kg
G = PARAMS.contact.gravity_m_s2
WEIGHT = (0.0, 0.0, -MASS * G)
NO_TORQUE = (0.0, 0.0, 0.0)
STANDING = -PARAMS.geometry.foot_bottom_m


def world(**target):
    return World(PARAMS, MASS, TargetSpec(**target))


def fall(w, steps, deck=None):
    bits = 0
    for k in range(steps):
        if deck and k % 10 == 0:
            deck(w, k)
        bits |= w.step(WEIGHT, NO_TORQUE)
    return bits


def test_free_fall_is_exact():
    w = world()
    w.set_vehicle((1.0, 2.0, 10.0), velocity=(0.5, -0.3, 1.0))
    fall(w, 1000)
    assert w.position == pytest.approx((1.5, 1.7, 10.0 + 1.0 - 0.5 * G), abs=1e-9)
    assert w.velocity == pytest.approx((0.5, -0.3, 1.0 - G), abs=1e-9)


def test_torque_is_in_the_body_frame():
    w = world()
    half = math.sqrt(0.5)
    w.set_vehicle((0.0, 0.0, 10.0), (half, 0.0, 0.0, half))  # nose north
    w.step(WEIGHT, (1.68e-5, 0.0, 0.0))
    assert w.rates == pytest.approx((STEP_S, 0.0, 0.0), abs=1e-12)


def test_spin_keeps_angular_momentum():
    w = world()
    w.set_vehicle((0.0, 0.0, 100.0), rates=(3.0, 0.1, 5.0))

    def momentum():
        axes = rotation_axes(w.quaternion)
        body = [j * r for j, r in zip(PARAMS.body.inertia_kg_m2, w.rates, strict=True)]
        return [sum(axes[3 * k + i] * body[k] for k in range(3)) for i in range(3)]

    before = momentum()
    fall(w, 1000)
    assert momentum() == pytest.approx(before, rel=0.02, abs=2e-6)


def test_quaternion_and_axes_are_inverse():
    q = (0.8, 0.1, -0.3, math.sqrt(1 - 0.64 - 0.01 - 0.09))
    assert quaternion_from_axes(rotation_axes(q)) == pytest.approx(q)


def test_deck_moves_on_an_exact_arc():
    w = world()
    w.set_vehicle((5.0, 0.0, 50.0))
    w.set_deck((1.0, 0.0, 0.2), 0.0, (0.0, 0.5, 0.1), 0.5)  # radius 1 m about the origin
    fall(w, 2000)
    assert w.deck_position == pytest.approx((math.cos(1.0), math.sin(1.0), 0.4), abs=1e-9)
    assert w.record.deck.velocity == pytest.approx((-0.5 * math.sin(1.0), 0.5 * math.cos(1.0), 0.1), abs=1e-9)
    assert w.record.deck.yaw == pytest.approx(1.0)


def test_stands_on_the_floor_and_sinks_by_less_than_a_tenth_of_a_millimetre():
    w = world()
    w.set_vehicle((1.0, 0.0, STANDING))
    assert fall(w, 1000) == ContactBit.GROUND.value
    assert w.position == pytest.approx((1.0, 0.0, STANDING), abs=1e-4)
    assert max(map(abs, w.velocity)) < 1e-6


def test_bounces_little():
    w = world()
    w.set_vehicle((1.0, 0.0, STANDING + 0.03))
    fall(w, 85)
    highest = 0.0
    for _ in range(300):
        w.step(WEIGHT, NO_TORQUE)
        highest = max(highest, w.position[2])
    assert highest < STANDING + 0.003


@pytest.mark.parametrize(
    ("offset", "speed", "rate"),
    [((0.0, 0.0), 0.1, 0.0), ((0.0, 0.0), 0.1, 0.1), ((0.03, -0.03), 0.5, 0.4), ((0.0, 0.05), 0.2, -0.5)],
)
def test_dropped_on_a_driving_pad_it_travels_with_it(offset, speed, rate):
    w = world()
    w.set_deck((0.0, 0.0, 0.2), 0.0, (speed, 0.0, 0.0), rate)
    w.set_vehicle((*offset, 0.2 + STANDING + 0.03), velocity=(speed, 0.0, 0.0))
    assert fall(w, 3100) == ContactBit.PAD.value
    x, y, z = (a - b for a, b in zip(w.position, w.deck_position, strict=True))
    c, s = math.cos(w.record.deck.yaw), math.sin(w.record.deck.yaw)
    body = (c * x + s * y, c * y - s * x)
    assert math.dist(body, offset) < 0.008  # while the pad drove more than 0.3 m
    assert z == pytest.approx(STANDING, abs=1e-4)
    vx, vy, vz = w.record.deck.velocity
    assert w.velocity == pytest.approx((vx - rate * y, vy + rate * x, vz), abs=5e-3)


def test_lands_at_rest_on_a_pad_that_drives_and_is_dragged_along():
    w = world()
    w.set_deck((0.0, 0.0, 0.2), 0.0, (0.1, 0.0, 0.0), 0.0)
    w.set_vehicle((0.0, 0.0, 0.2 + STANDING + 0.001))  # at rest in the world: slips at first
    fall(w, 1000)
    assert w.velocity[0] == pytest.approx(0.1, abs=1e-3)
    # mu g = 6.9 m/s^2 takes 15 ms to reach 0.1 m/s, less than a millimetre; falling 1 mm takes 14 ms
    assert w.deck_position[0] - w.position[0] == pytest.approx(0.002, abs=0.0015)


def test_rides_a_heaving_pad():
    w = world()
    w.set_vehicle((0.0, 0.0, 0.2 + STANDING))

    def deck(w, k):
        t, rate = k * STEP_S, 2.0 * math.pi * 0.25
        z, after = (0.2 + 0.15 * math.sin(rate * s) for s in (t, t + 0.01))
        w.set_deck((0.0, 0.0, z), 0.0, (0.0, 0.0, (after - z) / 0.01), 0.0)

    fall(w, 4000, deck)
    assert w.position[2] - w.deck_position[2] == pytest.approx(STANDING, abs=5e-4)


def test_friction_gives_up_beyond_its_cone():
    w = world()
    w.set_vehicle((1.0, 0.0, STANDING))
    fall(w, 200)
    for share, slips in ((0.5, False), (0.9, True)):
        w.set_vehicle((1.0, 0.0, STANDING - 1e-5))
        for _ in range(500):
            w.step((share * MASS * G, 0.0, -MASS * G), NO_TORQUE)
        assert (w.velocity[0] > 0.3) is slips


def test_the_deck_is_not_pushed_away():
    w = world()
    w.set_vehicle((0.0, 0.0, 0.2 + STANDING + 0.3))
    fall(w, 500)
    assert w.deck_position == (0.0, 0.0, 0.2)


def touched(position, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), steps=400):
    w = world()
    w.set_vehicle(position, quaternion, velocity)
    for _ in range(steps):
        bits = w.step(WEIGHT, NO_TORQUE)
        if bits & ~ContactBit.TUMBLED.value:
            return bits
    return 0


def test_what_is_touched_first():
    assert touched((0.0, 0.0, 0.25)) == ContactBit.PAD.value
    assert touched((1.0, 0.0, 0.05)) == ContactBit.GROUND.value
    # flying level into the pad's side; feet and board below its top, propellers above
    assert touched((0.25, 0.0, 0.197), velocity=(-2.0, 0.0, 0.4)) == ContactBit.PAD_EDGE.value
    # under the pad into the robot's body
    assert touched((0.3, 0.0, 0.1), velocity=(-2.0, 0.0, 0.5)) == ContactBit.ROBOT.value
    # on its back
    assert touched((1.0, 0.0, 0.05), (0.0, 1.0, 0.0, 0.0)) == ContactBit.GROUND | ContactBit.TUMBLED


def test_propellers_count_as_body():
    tilt = math.radians(50.0)
    q = (math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0)  # nose down: the front propellers touch first
    w = world()
    w.set_vehicle((1.0, 0.0, 0.06), q)
    while not (bits := w.step(WEIGHT, NO_TORQUE)):
        pass
    assert bits == ContactBit.GROUND.value
    assert w.position[2] > 0.03  # the feet are still clear


@pytest.mark.parametrize(("tilt_deg", "tumbled"), [(55.0, False), (65.0, True)])
def test_tumbled_is_a_tilt_beyond_sixty_degrees(tilt_deg, tumbled):
    half = math.radians(tilt_deg) / 2
    w = world()
    w.set_vehicle((0.0, 0.0, 10.0), (math.cos(half), math.sin(half), 0.0, 0.0))
    assert bool(w.step(WEIGHT, NO_TORQUE) & ContactBit.TUMBLED) is tumbled


def test_low_pads_and_bad_masses():
    low = world(pad_height_m=0.05)
    low.set_vehicle((0.0, 0.0, 0.05 + STANDING))
    assert fall(low, 200) == ContactBit.PAD.value
    with pytest.raises(ValueError, match="positive"):
        World(PARAMS, 0.0, TargetSpec())
