"""Tests the model of a vehicle at rest on the pad, which agrees with MuJoCo and ends when friction ends."""

import itertools
import math

import numpy as np
import pytest

from logs.schema.events import ContactBit
from sim.plant.params import load
from sim.scenarios.tables import TargetSpec
from sim.world.step import HOLDS, WAIT_STEPS, carried
from sim.world.world import World
from tests.unit.plant.worlds import advance

PARAMS = load()
MASS, G = PARAMS.body.mass_kg, PARAMS.contact.gravity_m_s2
WEIGHT = (0.0, 0.0, -MASS * G)
NO_TORQUE = (0.0, 0.0, 0.0)
STANDING_M = -PARAMS.geometry.foot_bottom_m
NEVER = 10**9
FRICTION = PARAMS.contact.friction


class Deck:
    """Sets the deck to its predicted pose every 10 ms, as the vehicle's process does."""

    def __init__(self, velocity_of, rate=0.0, height_m=0.2):
        self.velocity_of, self.rate = velocity_of, rate
        self.position, self.yaw = (0.0, 0.0, height_m), 0.4

    def place(self, world, step):
        if step % 10 == 0:
            if step:
                self.position, self.yaw = world.deck_pose
            world.set_deck(self.position, self.yaw, self.velocity_of(1e-3 * step), self.rate)


def stand(deck, seconds=3.0, wait_steps=WAIT_STEPS, place=(0.02, -0.01), force=WEIGHT, torque=NO_TORQUE):
    """Put a vehicle on the pad; return the world, and contact, motion and rest state of every step."""
    w = World(PARAMS, MASS, TargetSpec())
    w.record.rest.wait_steps = wait_steps
    deck.place(w, 0)
    (x, y, z), _ = w.deck_pose
    w.set_vehicle((x + place[0], y + place[1], z + STANDING_M - 1e-5), velocity=deck.velocity_of(0.0))
    rows = []
    for step in range(round(1000 * seconds)):
        deck.place(w, step)
        bits = advance(w, force(step) if callable(force) else force, torque)
        at = np.array(w.body().position_enu_m) - np.array(w.deck_pose[0])
        c, s = math.cos(w.record.deck.yaw), math.sin(w.record.deck.yaw)
        on_pad = (c * at[0] + s * at[1], c * at[1] - s * at[0], at[2])
        rows.append((bits, on_pad, *w.body()[1:], int(w.record.rest.steps)))
    return w, rows


def still(t):
    return (0.0, 0.0, 0.0)


def circle(t):
    return (0.3 * math.cos(0.5 * t), 0.3 * math.sin(0.5 * t), 0.0)


DECKS = {
    "standing": (still, 0.0),
    "turning": (still, 0.5),
    "driving off": (lambda t: (min(0.5 * t, 0.6), 0.0, 0.0), 0.0),
    "heaving": (lambda t: (0.2, 0.0, 0.1 * math.cos(2.0 * t)), 0.0),
    "on a circle": (circle, 0.5),
}


@pytest.mark.parametrize("name", DECKS)
def test_moves_as_with_the_contact_of_mujoco(name):
    velocity_of, rate = DECKS[name]
    w, resting = stand(Deck(velocity_of, rate))
    _, asked = stand(Deck(velocity_of, rate), wait_steps=NEVER)
    assert resting[-1][-1] == WAIT_STEPS
    assert sum(row[-1] == WAIT_STEPS for row in resting) > 2800
    assert {row[0] for row in resting[10:]} == {row[0] for row in asked[10:]} == {ContactBit.PAD}
    for (_, on_pad, v, q, rates, _), (_, on_pad_m, v_m, q_m, rates_m, _) in zip(resting, asked, strict=True):
        # MuJoCo's contact lets the vehicle creep by 0.1 to 0.3 mm a second
        assert on_pad == pytest.approx(on_pad_m, abs=1e-3)
        assert v == pytest.approx(v_m, abs=0.012)  # MuJoCo needs two time steps to follow a sudden change
        assert abs(np.dot(q, q_m)) > 1.0 - 1e-6
        assert rates == pytest.approx(rates_m, abs=0.05)
    assert np.linalg.norm(w.body().quaternion) == pytest.approx(1.0, abs=1e-12)


def test_does_not_creep_under_a_steady_wind():
    wind = (HOLDS * 0.9 * FRICTION * MASS * G, 0.0, -MASS * G)
    _, resting = stand(Deck(still), force=wind)
    _, asked = stand(Deck(still), force=wind, wait_steps=NEVER)
    begin = next(n for n, row in enumerate(resting) if row[-1] == WAIT_STEPS)
    # apart from rounding, the position relative to the deck is constant
    assert np.ptp([row[1] for row in resting[begin:]], axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    assert asked[-1][1][0] - asked[begin][1][0] > 1e-4


def brakes_hard(t):
    return (0.6 if t < 1.0 else max(0.0, 0.6 - 9.0 * (t - 1.0)), 0.0, 0.0)


def falls(t):
    return (0.0, 0.0, 0.0 if t < 1.0 else -20.0 * (t - 1.0))


def later(x, z):
    """Return a force as a function of the step: the weight for 1 s, then x and z times the weight."""
    return lambda step: WEIGHT if step < 1000 else (x * MASS * G, 0.0, z * MASS * G)


@pytest.mark.parametrize(
    ("velocity_of", "force"),
    [(brakes_hard, WEIGHT), (still, later(1.1 * FRICTION, -1.0)), (still, later(0.0, 0.2)), (falls, WEIGHT)],
    ids=["brakes", "storm", "lifts off", "falls"],
)
def test_goes_its_way_as_soon_as_friction_or_weight_do_not_hold(velocity_of, force):
    _, resting = stand(Deck(velocity_of), seconds=1.3, force=force)
    _, asked = stand(Deck(velocity_of), seconds=1.3, force=force, wait_steps=NEVER)
    assert resting[990][-1] == WAIT_STEPS
    assert resting[1030][-1] < WAIT_STEPS
    moved_m = np.linalg.norm(np.array(resting[-1][1]) - np.array(resting[990][1]))
    assert moved_m > 5e-3
    assert resting[-1][1] == pytest.approx(asked[-1][1], abs=0.02 * moved_m + 1e-4)


@pytest.mark.parametrize(
    ("place", "force", "torque"),
    [
        ((0.075, 0.0), WEIGHT, NO_TORQUE),  # a foot may be beyond the edge of the pad
        # thrust carries 60 % of the weight, so the feet carry less than ``LOADED``
        ((0.0, 0.0), (0.0, 0.0, -0.4 * MASS * G), NO_TORQUE),
        ((0.0, 0.0), WEIGHT, (0.3 * MASS * G * PARAMS.geometry.foot_offset_m, 0.0, 0.0)),
        ((0.0, 0.0), WEIGHT, (0.0, 0.0, 0.3 * FRICTION * MASS * G * PARAMS.geometry.foot_offset_m)),
    ],
)
def test_what_barely_stands_is_never_carried(place, force, torque):
    _, rows = stand(Deck(still), seconds=0.5, place=place, force=force, torque=torque)
    ready = [row[-1] == WAIT_STEPS for row in rows]
    assert not any(one and other for one, other in itertools.pairwise(ready))


@pytest.mark.parametrize("part", ["force", "torque"])
def test_a_force_that_is_not_a_number_holds_nothing(part):
    w, _ = stand(Deck(still), seconds=0.2)
    r = w.record
    getattr(r.wrench, part)[2] = math.nan
    assert not carried(r.rest, r.wrench, r.body, r.deck)
    assert r.rest.steps == 0
