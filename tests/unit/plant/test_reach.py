"""The step without MuJoCo: the same bits, and only where nothing can touch."""

import math
import random

import pytest

from sim.plant.params import load
from sim.scenarios.scenario import TargetSpec
from sim.world.contact import ContactBit
from sim.world.step import apart
from sim.world.world import World

PARAMS = load()
LOW_DECK = TargetSpec(pad_height_m=0.05)
HIGH_DECK = TargetSpec(pad_height_m=0.5, pad_radius_m=0.3)
SPECS = [TargetSpec(), LOW_DECK, HIGH_DECK]


def world(spec):
    return World(PARAMS, PARAMS.body.mass_kg, spec)


def attitude(rng):
    q = [rng.gauss(0.0, 1.0) for _ in range(4)]
    return tuple(c / math.hypot(*q) for c in q)


@pytest.mark.parametrize("spec", SPECS)
def test_apart_means_no_contact_wherever_and_however_the_vehicle_is(spec):
    w, rng = world(spec), random.Random(3)
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
        reach_m, free = r.reach.vehicle, apart(r.reach, r.body.position, r.deck.position)
        r.reach.vehicle = math.inf  # MuJoCo is asked
        bits = w.step((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        r.reach.vehicle = reach_m
        assert not (free and bits & ~ContactBit.TUMBLED.value), position
        seen[free] += 1
    assert min(seen.values()) > 500


@pytest.mark.parametrize("place", [(math.nan, 0.0, 1.0), (0.0, 0.0, math.nan)])
def test_what_is_not_a_number_is_never_apart(place):
    w = world(TargetSpec())
    w.set_vehicle(place)
    assert not apart(w.record.reach, w.record.body.position, w.record.deck.position)


def fall(spec, aside_m, searching):
    """A spinning fall past, or onto, a moving deck, and bounces; all numbers of every step."""
    w = world(spec)
    if searching:
        w.record.reach.vehicle = math.inf
    w.set_vehicle((aside_m, 0.01, spec.pad_height_m + 0.35), velocity=(0.2, 0.0, 0.0), rates=(0.5, -1.0, 2.0))
    w.set_deck((0.0, 0.0, spec.pad_height_m), 0.3, (0.2, 0.0, 0.0), 0.5)
    rows = []
    for k in range(1500):
        lift = 0.0 if k < 700 else 0.5  # up again and away
        bits = w.step((0.0, 0.0, lift - 0.3), (0.0, 0.0, 0.0))
        rows.append((bits, w.position, w.velocity, w.quaternion, w.rates, w.deck_position))
    return rows


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("aside_m", [0.0, 0.12, 0.5])
def test_the_step_without_mujoco_gives_the_same_bits(spec, aside_m):
    rows = fall(spec, aside_m, searching=False)
    assert repr(rows) == repr(fall(spec, aside_m, searching=True))
    assert {bool(row[0] & ~ContactBit.TUMBLED.value) for row in rows} == {False, True}
