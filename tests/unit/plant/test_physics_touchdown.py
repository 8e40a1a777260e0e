"""Contact against mechanics: bounce, friction, tipping."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sim.compiled.rotation import rotation_axes
from sim.plant.params import STEP_S, load
from sim.scenarios.scenario import TargetSpec
from sim.world.contact import ContactBit
from sim.world.world import World

PARAMS = load()
MASS, G = PARAMS.body.mass_kg, 9.81
WEIGHT, NO_TORQUE = (0.0, 0.0, -MASS * G), (0.0, 0.0, 0.0)
GEOMETRY, ROTOR = PARAMS.geometry, PARAMS.rotor
STANDING = -GEOMETRY.foot_bottom_m
FRICTION = 0.7  # crazyflie20.toml
ASIDE_M = 1.0  # on the floor, away from the pad


def world(params=PARAMS):
    return World(params, MASS, TargetSpec())


def tilted(angle, axis=(0.0, 1.0, 0.0)):
    return (math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis)).tolist())


def upright(w):
    return rotation_axes(w.quaternion)[8]


def drop(speed):
    """Fall level onto the floor: greatest speed upwards after the touch, height where it has it, and top."""
    w = world()
    w.set_vehicle((ASIDE_M, 0.0, STANDING + 1e-4), velocity=(0.0, 0.0, -speed))
    up, at, top, touched = 0.0, 0.0, 0.0, False
    for _ in range(400):
        touched = bool(w.step(WEIGHT, NO_TORQUE)) or touched
        if touched:
            top = max(top, w.position[2] - STANDING)
            if w.velocity[2] > up:
                up, at = w.velocity[2], w.position[2] - STANDING
    return up, at, top


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 3.0])
def test_a_bounce_goes_as_high_as_its_speed_carries_it(speed):
    """Restitution as the critically damped contact has it; from 2 m/s on it leaves the ground."""
    up, at, top = drop(speed)
    assert 0.1 < up / speed < 0.2
    # from its greatest speed on, still within the compressed contact, only the weight acts
    assert top == pytest.approx(max(0.0, at + up**2 / (2.0 * G)), abs=0.1e-3)
    assert (top > 1e-3) is (speed >= 2.0)


def test_bounce_speed_grows_with_the_landing_speed():
    speeds = [drop(v)[0] for v in (0.2, 0.5, 1.0, 2.0, 3.0)]
    assert speeds == sorted(speeds)
    assert speeds[0] < 0.03  # a landing at 0.2 m/s does not bounce


@pytest.mark.parametrize("speed", [0.1, 0.3, 0.6, 1.0])
@pytest.mark.parametrize("direction", [0.0, 0.3, math.pi / 4])
def test_slides_with_mu_g_and_stops(speed, direction):
    w = world()
    velocity = (speed * math.cos(direction), speed * math.sin(direction), 0.0)
    w.set_vehicle((ASIDE_M, 0.0, STANDING - 2e-5), velocity=velocity)
    for _ in range(1500):
        w.step(WEIGHT, NO_TORQUE)
    distance = math.hypot(w.position[0] - ASIDE_M, w.position[1])
    assert distance == pytest.approx(speed**2 / (2.0 * FRICTION * G), rel=0.02, abs=0.5 * speed * STEP_S)
    assert math.hypot(*w.velocity) < 1e-6
    assert upright(w) == pytest.approx(1.0, abs=1e-6)


def test_pushed_beyond_the_cone_it_gains_what_friction_leaves():
    w = world()
    w.set_vehicle((ASIDE_M, 0.0, STANDING))
    for _ in range(200):
        w.step(WEIGHT, NO_TORQUE)
    push, seconds, before = 1.0, 0.3, np.array(w.velocity)
    for _ in range(round(seconds * 1000)):
        w.step((push * MASS * G, 0.0, -MASS * G), NO_TORQUE)
    gained = np.array(w.velocity) - before
    support = G * seconds + gained[2]  # impulse of the ground over mass; it chatters on its feet
    assert gained[0] == pytest.approx(push * G * seconds - FRICTION * support, rel=0.02)
    assert gained[0] == pytest.approx((push - FRICTION) * G * seconds, rel=0.15)
    assert abs(gained[1]) < 1e-3


def test_level_landing_at_speed_slides_instead_of_tripping():
    """Friction at the feet tips it only if mu exceeds half span over height of the centre of mass, 2.5."""
    assert GEOMETRY.foot_offset_m / STANDING > FRICTION
    for speed in (1.0, 4.0):
        w = world()
        w.set_vehicle((ASIDE_M, 0.0, STANDING + 0.02), velocity=(speed, 0.0, -0.3))
        lowest = 1.0
        for _ in range(3000):
            w.step(WEIGHT, NO_TORQUE)
            lowest = min(lowest, upright(w))
        assert math.degrees(math.acos(lowest)) < 30.0  # rocks on a pair of feet; they alone tip at 68 degrees
        assert w.position[0] - ASIDE_M > 0.8 * speed**2 / (2.0 * FRICTION * G)


def test_feet_that_catch_trip_it_beyond_the_analytic_speed():
    """Feet that cannot slide stop at once: angular momentum about them stays, energy must lift the centre.

    m v h = I w and I w^2 / 2 = m g (r - h) about the front feet; the propellers meet the ground on the way.
    """
    r = math.hypot(GEOMETRY.foot_offset_m, STANDING)
    about_feet = PARAMS.body.inertia_kg_m2[1] + MASS * r**2
    critical = math.sqrt(2.0 * G * (r - STANDING) * about_feet / MASS) / STANDING
    sticky = replace(PARAMS, contact=replace(PARAMS.contact, friction=20.0))
    for speed, trips in ((0.4 * critical, False), (2.5 * critical, True)):
        w = world(sticky)
        w.set_vehicle((ASIDE_M, 0.0, STANDING), velocity=(speed, 0.0, 0.0))
        bits = 0
        for _ in range(1500):
            bits |= w.step(WEIGHT, NO_TORQUE)
        assert bool(bits & ContactBit.TUMBLED) is trips


def highest_tipping_angle():
    """Tilt about y beyond which it falls over: its centre is above the outermost point of the propellers.

    The rim of a front propeller, tip of the convex hull, is above the centre of mass: the angle is more than
    90 degrees, and a vehicle on its side still falls back on its feet.
    """
    reach, above = ROTOR.arm_m + ROTOR.radius_m, ROTOR.above_com_m
    return math.pi / 2 + math.atan2(above, reach)


@pytest.mark.parametrize(
    ("beyond_deg", "falls_over"), [(-30.0, False), (-6.0, False), (6.0, True), (30.0, True)]
)
def test_tips_over_beyond_the_angle_of_its_hull(beyond_deg, falls_over):
    angle = highest_tipping_angle() + math.radians(beyond_deg)
    w = world()
    q = tilted(angle)
    axes = np.array(rotation_axes(q)).reshape(3, 3).T
    thickness = GEOMETRY.propeller_half_thickness_m
    rim = [
        axes @ (ROTOR.arm_m + ROTOR.radius_m, 0.0, ROTOR.above_com_m + side * thickness)
        for side in (-1.0, 1.0)
    ]
    w.set_vehicle((ASIDE_M, 0.0, -min(p[2] for p in rim)), q)
    for _ in range(4000):
        w.step(WEIGHT, NO_TORQUE)
    assert upright(w) == pytest.approx(-1.0 if falls_over else 1.0, abs=0.02)


@pytest.mark.parametrize("angle_deg", [2.0, 10.0, 30.0, 50.0])
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0)])
def test_on_its_feet_it_always_falls_back(angle_deg, axis):
    """The static tipping angle of the feet, atan(span/2 over height), is beyond where the rims touch."""
    assert math.radians(angle_deg) < math.atan2(GEOMETRY.foot_offset_m, STANDING)
    w = world()
    w.set_vehicle((ASIDE_M, 0.0, 0.06), tilted(math.radians(angle_deg), axis))
    for _ in range(2500):
        w.step(WEIGHT, NO_TORQUE)
    assert upright(w) == pytest.approx(1.0, abs=1e-4)
    assert w.position[2] == pytest.approx(STANDING, abs=1e-4)
    assert math.hypot(*w.rates) < 1e-3
