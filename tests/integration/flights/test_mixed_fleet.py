"""Flies a fleet in real time: a simulated vehicle, PX4 if installed, and a Crazyflie with its bridge."""

import contextlib
import itertools
import math

import numpy as np
import pytest

from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from logs.schema.controller_rows import unpack_neighbours
from logs.schema.rows import MemberStatusRow
from logs.verdict.verdict import judge_fleet
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import Px4Model, Px4Program
from sim.scenarios.scenario import load
from tests.integration.runs import Flying, called
from tests.integration.sim_processes import ROOT, verb
from tests.integration.wires.bridge_processes import member_behind_the_bridge
from tests.processes.ports import free_port
from tests.px4_place import px4_or_skip

TEAM = ROOT / "examples" / "mixed_fleet.toml"
SEED, SECOND, CRAZYFLIE = 1, 2, 3
READY_S = 200.0  # time-out until PX4 can arm, s, also on a busy machine


@contextlib.contextmanager
def second_member(kind, folder, robots, place):
    """Run the second vehicle: the simulated vehicle, or PX4 as instance 1, whose system id is 2."""
    words = ("--scenario", TEAM, "--seed", SEED, "--member", SECOND, "--connect", robots)
    if kind == "sitl":
        with verb("vehicle", *words, "--url", f"udpin:{place}"):
            yield
        return
    scenario, _ = load(TEAM).one(SEED, SECOND)
    wanted = parameters(params.load(scenario.vehicle.airframe), scenario.vehicle.mocap)
    with verb("px4-sim", *words, "--mocap", "--once", "--tcp", "127.0.0.1:4561"):
        px4 = Px4Program(px4_or_skip(), folder, Px4Model.NONE_IRIS, instance=1, parameters=wanted)
        try:
            px4.boot(READY_S)
            yield
        finally:
            px4.end()


def places(log):
    """Return the reported times and positions by number of the member."""
    told = {number: [] for number in (1, 2, 3)}
    for message in log.messages({f"/cf{number}/fleet/status" for number in told}):
        word = MemberStatusRow.unpack(message.data)
        told[word.id].append((word.stamp_ns * 1e-9, *word.position_enu_m))
    return {number: np.array(rows) for number, rows in told.items()}


def least_rho(one, other, fleet):
    """Return the smallest ellipsoid norm between two members, computed from the reported positions."""
    t = np.arange(max(one[0, 0], other[0, 0]), min(one[-1, 0], other[-1, 0]), 0.02)
    x, y, z = (np.interp(t, one[:, 0], one[:, k]) - np.interp(t, other[:, 0], other[:, k]) for k in (1, 2, 3))
    return float(np.sqrt((x * x + y * y) / fleet.radius_xy_m**2 + z * z / fleet.radius_z_m**2).min())


@pytest.mark.xdist_group("real-time")
@pytest.mark.parametrize("second", ["sitl", pytest.param("px4", marks=pytest.mark.xdist_group("stream 0"))])
def test_three_kinds_hear_each_other_cross_land_and_replay(second, tmp_path):
    if second == "px4":
        px4_or_skip()
    at = [f"127.0.0.1:{free_port(udp=True)}" for _ in range(2)]
    urls = {
        SECOND: f"udpout:{at[0]}" if second == "sitl" else "udpin:127.0.0.1:14541",
        CRAZYFLIE: f"udpout:{at[1]}",
    }
    members = [word for number, url in urls.items() for word in ("--member", f"{number}={url}")]
    run = Flying(tmp_path / "out", "--scenario", TEAM, "--seed", SEED, *members)
    try:
        robots = run.until("robots: ").split()[1]
        crazyflie = (*load(TEAM).one(SEED, CRAZYFLIE), CRAZYFLIE, f"udpin:{at[1]}", robots)
        with (
            member_behind_the_bridge(*crazyflie) as plant,
            second_member(second, tmp_path / "second", robots, at[0]),
        ):
            assert run.end() == 0, "\n".join(run.lines)
            truth = plant.vehicle.truth()
    finally:
        run.kill()
    team, kinds = load(TEAM), {1: "sitl", SECOND: second, CRAZYFLIE: "crazyflie"}
    touched_m = math.dist(truth.position_enu_m[:2], truth.pad_position_enu_m[:2])
    assert touched_m < team.target.pad_radius_m
    fleet, log = load_fleet(run.out / "flight.mcap"), LogFile(run.out / "flight.mcap")
    verdict = judge_fleet(fleet)
    assert [each.judged_from for each in verdict.members.values()] == ["truth", "estimate", "estimate"]
    assert verdict.collisions is None  # the true positions of two members are unknown
    for number, kind in kinds.items():
        assert log.metadata()[f"cf{number}/preflight"]["profile"] == kind
        result = replay(run.out / "flight.mcap", member=f"cf{number}")
        assert result.equal, result.outputs.first + result.states.first
        messages = log.messages({f"/cf{number}/controller/neighbours"})
        heard = [word for message in messages for word in unpack_neighbours(message.data)]
        assert {word.id for word in heard} == kinds.keys() - {number}
        assert np.median([word.clock_bound_s for word in heard]) < 0.02  # half a tick plus latency, s
    told = places(log)
    for one, other in itertools.combinations(kinds, 2):
        assert least_rho(told[one], told[other], team.onboard.fleet) > 1.0
    assert not any(b" jumps by " in message.data for message in log.messages({"/rosout"}))


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--scenario", "fleet_3", "--member", "4=udpin:127.0.0.1:1"), "found 4; allowed are 1 to 3"),
        (("--scenario", "fleet_3", "--member", "two=udpin:127.0.0.1:1"), "N=URL is needed"),
        (("--scenario", "field", "--member", "1=udpin:127.0.0.1:1"), "allowed are 1 to 1, and one"),
        (
            ("--scenario", "fleet_3", "--lockstep", "--member", "2=udpin:127.0.0.1:1"),
            "--member with --lockstep: it cannot run in lockstep",
        ),
    ],
)
def test_members_that_cannot_fly_from_elsewhere_are_refused(words, why, tmp_path):
    done = called("sitl", *words, "--out", tmp_path / "out")
    assert done.code == 2
    assert why in done.err
