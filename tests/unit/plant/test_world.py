"""Tests body, deck and contact against mechanics, and that MuJoCo runs only if contact is possible."""

import math
import random

import numpy as np
import pytest

from logs.schema.events import ContactBit
from sim.plant.params import load
from sim.scenarios.tables import TargetSpec
from sim.world.step import apart
from sim.world.world import World
from tests.unit.plant.worlds import advance

pytestmark = pytest.mark.slow

PARAMS = load()
MASS = PARAMS.body.mass_kg
G = PARAMS.contact.gravity_m_s2
WEIGHT = (0.0, 0.0, -MASS * G)
GEOMETRY = PARAMS.geometry
STANDING = -GEOMETRY.foot_bottom_m


def world(params=PARAMS, target=None):
    return World(params, MASS, target or TargetSpec())


def touched(position, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), steps=400):
    w = world()
    w.set_vehicle(position, quaternion, velocity)
    for _ in range(steps):
        bits = advance(w, WEIGHT)
        if bits & ~ContactBit.TUMBLED.value:
            return bits
    return 0


def test_what_is_touched_first():
    assert touched((0.0, 0.0, 0.25)) == ContactBit.PAD.value
    assert touched((1.0, 0.0, 0.05)) == ContactBit.GROUND.value
    # level flight into the pad's side: feet and board are below the pad's top, propellers above
    assert touched((0.25, 0.0, 0.197), velocity=(-2.0, 0.0, 0.4)) == ContactBit.PAD_EDGE.value
    # flight under the pad into the robot's body
    assert touched((0.3, 0.0, 0.1), velocity=(-2.0, 0.0, 0.5)) == ContactBit.ROBOT.value
    # upside-down fall onto the ground
    assert touched((1.0, 0.0, 0.05), (0.0, 1.0, 0.0, 0.0)) == ContactBit.GROUND | ContactBit.TUMBLED


def test_propellers_count_as_body():
    tilt = math.radians(50.0)
    q = (math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0)  # nose down: the front propellers touch first
    w = world()
    w.set_vehicle((1.0, 0.0, 0.06), q)
    while not (bits := advance(w, WEIGHT)):
        pass
    assert bits == ContactBit.GROUND.value
    assert w.body().position_enu_m[2] > 0.03  # the feet do not touch the ground yet


@pytest.mark.parametrize(("tilt_deg", "tumbled"), [(55.0, False), (65.0, True)])
def test_tumbled_is_a_tilt_beyond_sixty_degrees(tilt_deg, tumbled):
    half = math.radians(tilt_deg) / 2
    w = world()
    w.set_vehicle((0.0, 0.0, 10.0), (math.cos(half), math.sin(half), 0.0, 0.0))
    assert bool(advance(w, WEIGHT) & ContactBit.TUMBLED) is tumbled


def tilted(angle, axis=(0.0, 1.0, 0.0)):
    return (math.cos(angle / 2), *(math.sin(angle / 2) * np.array(axis)).tolist())


LOW_DECK = TargetSpec(pad_height_m=0.05)
HIGH_DECK = TargetSpec(pad_height_m=0.5, pad_radius_m=0.3)
SPECS = [TargetSpec(), LOW_DECK, HIGH_DECK]


def attitude(rng):
    q = [rng.gauss(0.0, 1.0) for _ in range(4)]
    return tuple(c / math.hypot(*q) for c in q)


@pytest.mark.parametrize("spec", SPECS)
def test_apart_means_no_contact_wherever_and_however_the_vehicle_is(spec):
    w, rng = world(target=spec), random.Random(3)
    seen = {True: 0, False: 0}
    for _ in range(4000):
        position = (
            rng.uniform(-0.4, 0.4),
            rng.uniform(-0.4, 0.4),
            rng.uniform(-0.05, spec.pad_height_m + 0.2),
        )
        w.set_vehicle(position, attitude(rng))
        w.set_deck(
            (rng.uniform(-0.1, 0.1), 0.0, spec.pad_height_m), rng.uniform(-4.0, 4.0), (0.0, 0.0, 0.0), 0.0
        )
        r = w.record
        reach_m, free = (r.reach.robot, r.reach.robot_top), apart(r.reach, r.body, r.deck)
        r.reach.robot = r.reach.robot_top = math.inf  # MuJoCo runs in every step
        bits = advance(w, (0.0, 0.0, 0.0))
        r.reach.robot, r.reach.robot_top = reach_m
        assert not (free and bits & ~ContactBit.TUMBLED.value), position
        seen[free] += 1
    assert min(seen.values()) > 500


@pytest.mark.parametrize(
    ("height_m", "tilt", "free"),
    [(0.004, 0.0, True), (0.0005, 0.0, False), (0.004, 1.0, False), (0.06, 1.0, True)],
)
def test_a_level_vehicle_just_above_the_pad_touches_nothing(height_m, tilt, free):
    w = world(target=TargetSpec(pad_height_m=0.2))
    w.set_vehicle((0.0, 0.0, 0.2 + STANDING + height_m), tilted(tilt, (1.0, 0.0, 0.0)))
    assert apart(w.record.reach, w.record.body, w.record.deck) == free


@pytest.mark.parametrize("place", [(math.nan, 0.0, 1.0), (0.0, 0.0, math.nan)])
def test_what_is_not_a_number_is_never_apart(place):
    w = world()
    w.set_vehicle(place)
    assert not apart(w.record.reach, w.record.body, w.record.deck)


def tumble_past(spec, aside_m, searching):
    """Simulate a tumbling fall past or onto a moving deck, with bounces; return the state of every step."""
    w = world(target=spec)
    if searching:
        w.record.reach.robot = w.record.reach.robot_top = math.inf
    w.set_vehicle((aside_m, 0.01, spec.pad_height_m + 0.35), velocity=(0.2, 0.0, 0.0), rates=(0.5, -1.0, 2.0))
    w.set_deck((0.0, 0.0, spec.pad_height_m), 0.3, (0.2, 0.0, 0.0), 0.5)
    rows = []
    for k in range(1500):
        lift = 0.0 if k < 700 else 0.5  # thrust later moves the vehicle upwards
        bits = advance(w, (0.0, 0.0, lift - 0.3))
        rows.append((bits, *w.body(), w.deck_pose[0]))
    return rows


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("aside_m", [0.0, 0.12, 0.5])
def test_the_step_without_mujoco_gives_the_same_bits(spec, aside_m):
    rows = tumble_past(spec, aside_m, searching=False)
    assert repr(rows) == repr(tumble_past(spec, aside_m, searching=True))
    assert {bool(row[0] & ~ContactBit.TUMBLED.value) for row in rows} == {False, True}
