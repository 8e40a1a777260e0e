"""Vehicles of a fleet in real time: one of ``sitl``, two with their own URLs, the last one a Crazyflie."""

import numpy as np
import pytest

from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from logs.schema.controller_rows import unpack_neighbours
from logs.verdict.verdict import judge_fleet
from sim.scenarios.team import load
from tests.integration.runs import Flying, called
from tests.integration.sim_processes import verb
from tests.integration.wires.bridge_processes import member_behind_the_bridge
from tests.processes.ports import free_port

TEAM = """
name = "two_cross"
description = "Two vehicles fly to each other's side of the room, a third one lands beside them"
base = "paper_static_1"
[start]
kind = "hover"
[onboard.fleet]
members = [1, 2, 3]
id = 1
[[member]]
target.position_m = [1.0, 0.0]
start.offset_m = [-2.2, 0.1, 1.0]
[[member]]
onboard.fleet.id = 2
target.position_m = [-1.0, 0.0]
start.offset_m = [2.2, -0.1, 1.0]
[[member]]
onboard.fleet.id = 3
onboard.takeoff.start_offset_m = [-0.6, 0.3, 0.7]
target.position_m = [0.0, 2.0]
start.kind = "ground"
start.ground_position_m = [-0.6, 2.3]
"""
KINDS = {1: "sitl", 2: "sitl", 3: "crazyflie"}


@pytest.mark.xdist_group("real-time")
def test_vehicles_from_three_sources_hear_each_other_land_and_replay(tmp_path):
    (team_file := tmp_path / "team.toml").write_text(TEAM)
    places, out = [f"127.0.0.1:{free_port(udp=True)}" for _ in range(2)], tmp_path / "out"
    options = ("--seed", 1, "--duration", 90)
    members = [f"{n}=udpout:{place}" for n, place in enumerate(places, 2)]
    run = Flying(out, "--scenario", team_file, *options, *(w for m in members for w in ("--member", m)))
    try:
        robots = run.until("robots: ").split()[1]
        words = ("--scenario", team_file, "--seed", 1, "--member", 2, "--url", f"udpin:{places[0]}")
        crazyflie = (*load(team_file).one(1, 3), 3, f"udpin:{places[1]}", robots)
        with verb("vehicle", *words, "--connect", robots), member_behind_the_bridge(*crazyflie) as plant:
            assert run.end() == 0, "\n".join(run.lines)
            assert plant.vehicle.on_pad
    finally:
        run.kill()
    fleet, log = load_fleet(out / "flight.mcap"), LogFile(out / "flight.mcap")
    verdict = judge_fleet(fleet)
    assert [each.judged_from for each in verdict.members.values()] == ["truth", "estimate", "estimate"]
    assert verdict.collisions is None  # the true positions of the others are unknown
    for n, kind in KINDS.items():
        assert log.metadata()[f"cf{n}/preflight"]["profile"] == kind
        result = replay(out / "flight.mcap", member=f"cf{n}")
        assert result.equal, result.outputs.first + result.states.first
        messages = log.messages({f"/cf{n}/controller/neighbours"})
        heard = [word for message in messages for word in unpack_neighbours(message.data)]
        assert {word.id for word in heard} == KINDS.keys() - {n}
        bounds_s = np.array([word.clock_bound_s for word in heard])
        assert np.median(bounds_s) < 0.02  # half a tick plus the machine's latency


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--scenario", "fleet_3", "--member", "4=udpin:127.0.0.1:1"), "found 4; allowed are 1 to 3"),
        (("--scenario", "fleet_3", "--member", "two=udpin:127.0.0.1:1"), "N=URL is needed"),
        (("--scenario", "field", "--member", "1=udpin:127.0.0.1:1"), "it is for one of several vehicles"),
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
