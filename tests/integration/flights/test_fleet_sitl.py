"""Tests ``sitl`` with a team: members fly as in ``land``; a killed process harms no other member."""

import os
import signal
from dataclasses import fields

import numpy as np
import pytest

from flightstack.core.types import ZERO, Phase
from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.verdict.types import Outcome
from logs.verdict.verdict import judge_fleet
from sim.runners.landing import land
from sim.scenarios.scenario import load
from tests.integration.runs import Flying, called

TEAM, SEED = "fleet_3", 1
NAMES = ["cf1", "cf2", "cf3"]


@pytest.fixture(scope="module")
def wired(flown):
    """Fly a team in lockstep, each member in its own process; return the finished run."""
    done = flown(TEAM, SEED)
    assert done.code == 0, done.out + done.err
    return done


@pytest.fixture(scope="module")
def fleet(wired):
    return load_fleet(wired.log)


@pytest.fixture(scope="module")
def direct():
    """Fly the same team in one process; return its result, and the commands of all members at each tick."""
    commands = []

    def keep(_, out):
        commands.append(out.setpoint.velocity_enu_m_s if out.setpoint is not None else ZERO)

    return land(load(TEAM), SEED, on_step=keep), commands


same_flight = pytest.mark.xdist_group("fleet in lockstep")  # one worker runs the group: the team flies once


@same_flight
def test_each_member_flies_as_in_one_process_to_the_bit(fleet, direct):
    landed, commands = direct
    assert list(fleet.flights) == NAMES
    steps = [flight.steps for flight in fleet.flights.values()]
    order = sorted((tick, n) for n, each in enumerate(steps) for tick in range(len(each.t_s)))
    assert np.array_equal(np.array(commands), [steps[n].command_enu_m_s[tick] for tick, n in order])
    for flight, landing in zip(fleet.flights.values(), landed.members, strict=True):
        for seen, logged in ((landing.seen.steps, flight.steps), (landing.seen.truth, flight.truth)):
            for name in (field.name for field in fields(seen)):
                x, y = getattr(seen, name), getattr(logged, name)
                assert np.array_equal(x, y, equal_nan=y.dtype.kind == "f"), name


@same_flight
def test_the_log_knows_how_near_they_came(fleet, direct):
    pairs = direct[0].pairs
    assert [(pair.one, pair.other) for pair in pairs] == list(fleet.pairs)
    for pair, row in zip(pairs, fleet.pairs.values(), strict=True):
        assert row._replace(stamp_ns=0) == pair
        assert pair.collided_ms == -1


@same_flight
def test_one_object_says_what_became_of_all(wired, direct):
    found, landed = wired.json, direct[0]
    assert {name: found[name] for name in ("scenario", "seed", "filter", "outcome", "violation")} == {
        "scenario": TEAM, "seed": SEED, "filter": "robust", "outcome": "landed", "violation": False,
    }  # fmt: skip
    assert found["collisions"] == found["ellipsoid_violations"] == 0
    assert found["distance_min_m"] == min(pair.distance_min_m for pair in landed.pairs)
    assert found["ellipsoid_min"] == min(pair.ellipsoid_min for pair in landed.pairs)
    assert found["realtime_factor"] > 0.0
    assert list(found["vehicles"]) == NAMES
    for vehicle, landing in zip(found["vehicles"].values(), landed.members, strict=True):
        verdict = landing.verdict.to_json_dict()
        assert {name: vehicle[name] for name in verdict} == verdict
        assert vehicle["seed"] == landing.seed


@same_flight
def test_the_log_holds_what_flies_it_again(wired):
    log = LogFile(wired.log)
    metadata, attachments = log.metadata(), {each.name: each.data for each in log.attachments()}
    assert metadata["fleet"]["members"] == "cf1,cf2,cf3"
    assert {f"{name}/{record}" for name in NAMES for record in ("run", "onboard")} <= metadata.keys()
    assert not {"run", "onboard"} & metadata.keys()
    assert {f"{name}/onboard.toml" for name in NAMES} < attachments.keys()
    assert attachments["scenario.toml"] == (wired.folder / "scenario.toml").read_bytes()
    team, again = load(TEAM), load(wired.folder / "scenario.toml")
    assert (team.members, team.exchange, team.name) == (again.members, again.exchange, again.name)
    assert set(metadata["losses"].values()) == {"0"}


def test_a_process_that_is_killed_in_flight_harms_nobody(tmp_path):
    words = ("--scenario", TEAM, "--seed", SEED, "--duration", 20, "--lockstep")
    run = Flying(tmp_path / "out", *words)
    try:
        run.until("APPROACH -> LAND")
        os.kill(run.children()["onboard-cf2"], signal.SIGKILL)
        assert run.end() == 1
    finally:
        run.kill()
    assert any("onboard-cf2 ended in flight" in line for line in run.lines), run.lines
    fleet = load_fleet(tmp_path / "out" / "flight.mcap")
    verdict = judge_fleet(fleet)
    assert verdict.collisions == verdict.ellipsoid_violations == 0
    # a vehicle may land beside its pad if the silent vehicle may be too close to this pad
    for name in ("cf1", "cf3"):
        assert verdict.members[name].outcome in (Outcome.LANDED, Outcome.ABORTED), verdict.members[name]
        assert fleet.flights[name].phase_spans()[-1][0] in (Phase.LANDED, Phase.ABORT)
    assert not fleet.flights["cf2"].truth.motors_running[-1]  # cf2's autopilot landed it


@pytest.mark.parametrize(
    ("option", "why"),
    [
        (("--px4", "/"), "--px4 with a scenario of 3 vehicles: it flies at most 1; the vehicles of a team"),
        (("--duration", "-1"), "--duration"),
    ],
)
def test_what_several_vehicles_do_not_have_is_refused(option, why, tmp_path):
    done = called("sitl", "--scenario", TEAM, "--out", tmp_path / "out", *option)
    assert done.code == 2
    assert why in done.err
