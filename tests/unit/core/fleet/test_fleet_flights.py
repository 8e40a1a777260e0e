"""Several vehicles, each with its own controller, land and always keep their distance."""

import math

import numpy as np
import pytest

from flightstack.common.strict_toml import ConfigError
from flightstack.core.controller import Controller
from flightstack.core.types import FilterStatus, Inputs, Intent, Landed, Mode, OwnState, Phase, VehicleStatus
from tests.unit.core.core_helpers import config
from tests.unit.core.fleet.fleet_helpers import (
    DT_S,
    Flyer,
    Sky,
    all_landed,
    driving,
    fleet,
    parked,
    settings_of,
)

LATE = (0.02, 0.1)  # range of the message delay, s


def flyers(starts, pads, keys=None, **sections):
    ids = tuple(range(1, len(starts) + 1))
    return [
        Flyer(settings_of(n, ids, keys, **sections), start, pad)
        for n, start, pad in zip(ids, starts, pads, strict=True)
    ]


def told(sky):
    return [(f.id, f.phase.name, f.texts[-3:]) for f in sky.flyers]


def test_two_that_meet_head_on_pass_each_other_and_land():
    sky = Sky(flyers([(-2.0, 0.0, 1.0), (2.0, 0.0, 1.0)], [parked(2.0, 0.0), parked(-2.0, 0.0)]), LATE)
    sky.run(25.0, all_landed)
    assert all_landed(sky), told(sky)
    assert sky.least_h_m >= 0.0, sky.least_at


@pytest.mark.parametrize("seed", [1])
def test_three_land_on_pads_that_drive_and_cross(seed):
    starts = [(-2.0, 0.0, 1.0), (2.0, 0.3, 1.0), (0.0, 2.0, 1.2)]
    pads = [driving(1.0, -0.8, -0.1, 0.02), driving(-1.0, 0.8, 0.1, 0.0), driving(0.2, -2.0, 0.0, 0.1)]
    sky = Sky(flyers(starts, pads), LATE, seed=seed)
    sky.run(60.0, all_landed)
    assert all_landed(sky), told(sky)
    assert sky.least_h_m >= 0.0, sky.least_at


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_eight_change_places(seed):
    ring = [2.0 * math.pi * k / 8 for k in range(8)]
    starts = [(2.5 * math.cos(a), 2.5 * math.sin(a), 1.0) for a in ring]
    pads = [parked(-2.0 * math.cos(a), -2.0 * math.sin(a)) for a in ring]
    sky = Sky(flyers(starts, pads), LATE, seed=seed)
    sky.run(40.0, all_landed)
    assert all_landed(sky), told(sky)
    assert sky.least_h_m >= 0.0, sky.least_at
    assert FilterStatus.CLOSED_FORM not in {s for f in sky.flyers for s in f.statuses}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_one_falls_silent_and_nobody_comes_too_near(seed):
    starts = [(-2.0, 0.0, 1.0), (2.0, 0.0, 1.0), (0.0, 2.0, 1.0)]
    pads = [parked(2.0, 0.1), parked(-2.0, 0.0), parked(0.1, -2.0)]
    keys, sections = {"silent_flight_s": 1.5, "wait_max_s": 10.0}, {"checks": {"landing_time_max_s": 25.0}}
    sky = Sky(flyers(starts, pads, keys, **sections), LATE, seed=seed)
    silent = sky.flyers[seed % 3]
    silent.silent_from_s = np.random.default_rng(seed).uniform(0.5, 8.0)  # it flies on and still receives
    sky.run(70.0, lambda s: all(not f.armed for f in s.flyers))
    assert all(not f.armed for f in sky.flyers), told(sky)
    assert sky.least_h_m >= 0.0, sky.least_at
    for flyer in sky.flyers:
        assert flyer.on_pad or Phase.ABORT in flyer.phases


def test_a_pad_on_which_one_stands_is_waited_for_and_given_up_in_order():
    sky = Sky(flyers([(2.0, 0.0, 1.0), (-2.0, 0.0, 1.0)], [parked(0.0, 0.0)] * 2, {"wait_max_s": 15.0}), LATE)
    sky.run(60.0, lambda s: all(not f.armed for f in s.flyers))
    (first,), (second,) = ([f for f in sky.flyers if f.on_pad is landed] for landed in (True, False))
    assert first.phase is Phase.LANDED
    assert f"landing took too long: no right of way because of member {first.id}" in " ".join(second.texts)
    assert math.dist(second.position[:2], (0.0, 0.0)) >= second.config.checks.clearance_m - 0.05
    assert sky.least_h_m >= 0.0


def test_nobody_takes_off_before_all_are_heard_and_the_reason_says_who():
    settings_ = settings_of(3, (3, 7, 9), checks={"wait_time_max_s": 1.0})
    flyer = Flyer(settings_, (1.0, 0.0, 0.015), parked(0.0, 0.0), landed=Landed.ON_GROUND)
    for tick in range(60):
        flyer.step(tick * DT_S, [])
    assert flyer.phases[:2] == [Phase.WAIT, Phase.ABORT]
    assert any("inputs did not become ready in time: not heard members 7, 9" in text for text in flyer.texts)


def test_a_refused_word_and_a_crowd_are_events():
    flyer = Flyer(settings_of(3, (3, 7, 9)), (0.0, 0.0, 1.5), parked(0.0, 0.0))
    others = [Flyer(settings_of(n, (3, 7, 9)), p, parked(0.0, 0.0)) for n, p in
              ((7, (0.1, 0.0, 1.5)), (9, (-0.1, 0.0, 1.5)))]  # fmt: skip
    for tick in range(100):
        words = [f.word for f in others if f.word is not None]
        flyer.step(tick * DT_S, words)
        for other in others:
            other.step(tick * DT_S, [])
            other.position = (math.copysign(0.1, other.position[0]), 0.0, 1.5)
            if other.word is not None and tick == 50:
                flyer.step(tick * DT_S, [other.word._replace(id=4)])
    assert FilterStatus.CROWDED in flyer.statuses
    assert sum("no velocity keeps clear of all other vehicles" in text for text in flyer.texts) >= 1
    assert "word of vehicle 4 refused: it is no other member" in flyer.texts


def test_the_landing_barrier_is_held_in_a_crowd():
    flyer = Flyer(settings_of(3, (3, 7)), (0.8, 0.0, 0.75), parked(0.0, 0.0))
    above = Flyer(settings_of(7, (3, 7)), (0.8, 0.0, 1.0), parked(5.0, 0.0))
    for tick in range(150):
        above.position = (flyer.position[0], flyer.position[1], flyer.position[2] + 0.3)
        above.step(tick * DT_S, [])
        out = flyer.step(tick * DT_S, [above.word] if above.word is not None else [])
        if out.barrier is not None and flyer.phase is Phase.APPROACH and tick > 20:
            assert out.barrier.result.slack_m_s >= -1e-5
            assert out.barrier.h_m > 0.0
    assert flyer.statuses


def test_a_vehicle_that_does_not_know_where_it_is_says_nothing():
    controller = Controller(settings_of(3, (3, 7)))
    status = VehicleStatus(0.0, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    assert controller.step(Inputs(None, status), 0.0).own_word is None
    own = OwnState(0.0, 0.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
    assert controller.step(Inputs(own, status), 0.0).own_word.intent is Intent.WAITING
    assert controller.step(Inputs(own, status), 1.0).own_word is None


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"members": [3]}, "members: found 1"),
        ({"members": [7, 9]}, "id 3"),
        ({"members": [3, 7, 7]}, "each once"),
        ({"members": list(range(1, 11))}, "members: found 10, allowed are 2 to 9"),
        ({"id": 251}, "1 to 250"),
        ({"reach_m": 2.7}, "reach_m: found 2.7"),
        ({"age_max_s": 0.4}, "age_max_s: found 0.4"),
        ({"pad_distance_m": 0.45}, "pad_distance_m: found 0.45"),
        ({"wait_distance_m": 0.7}, "wait_distance_m: found 0.7"),
        ({"rate_1_s": 1.0}, "fleet.rate_1_s: found 1"),
        ({"latency_max_s": 0.015}, "fleet.latency_max_s: found 0.015"),
    ],
)
def test_a_fleet_that_cannot_work_is_refused(keys, why):
    table = {**fleet(), **keys}
    with pytest.raises(ConfigError, match=why):
        config(fleet=table, loop={"rate_hz": 50})
