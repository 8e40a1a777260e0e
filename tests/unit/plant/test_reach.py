"""The step without search for contacts: the same bits, and only where nothing can touch."""

import math
import random

import mujoco
import pytest

from sim.plant.params import load
from sim.scenarios.scenario import TargetSpec
from sim.world.world import World, contact_count
from sim.world.world_xml import apart

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
        free = apart(w.reach, w.body.position, w.deck.position)
        w.data.qpos[7:11] = (*w.deck.position, w.deck.yaw)
        mujoco.mj_forward(w._model, w.data)
        assert not (free and w.data.ncon), position
        seen[free] += 1
    assert min(seen.values()) > 500


@pytest.mark.parametrize("place", [(math.nan, 0.0, 1.0), (0.0, 0.0, math.nan)])
def test_what_is_not_a_number_is_never_apart(place):
    w = world(TargetSpec())
    w.set_vehicle(place)
    assert not apart(w.reach, w.body.position, w.deck.position)


def fall(spec, aside_m, searching):
    """A spinning fall past, or onto, a moving deck, and bounces; all numbers of every step."""
    w = world(spec)
    if searching:
        w.memory.free_model = w.memory.model
    w.set_vehicle((aside_m, 0.01, spec.pad_height_m + 0.35), velocity=(0.2, 0.0, 0.0), rates=(0.5, -1.0, 2.0))
    w.set_deck((0.0, 0.0, spec.pad_height_m), 0.3, (0.2, 0.0, 0.0), 0.5)
    rows, counts = [], []
    for k in range(1500):
        lift = 0.0 if k < 700 else 0.5  # up again and away
        rows.append(
            (w.step((0.0, 0.0, lift - 0.3), (0.0, 0.0, 0.0)), w.data.qpos.tolist(), w.data.qvel.tolist())
        )
        counts.append(contact_count(w.memory))
    return rows, counts


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("aside_m", [0.0, 0.12, 0.5])
def test_the_step_without_the_search_gives_the_same_bits(spec, aside_m):
    rows, counts = fall(spec, aside_m, searching=False)
    assert repr(rows) == repr(fall(spec, aside_m, searching=True)[0])
    assert 0 in counts
    assert max(counts) > 0
