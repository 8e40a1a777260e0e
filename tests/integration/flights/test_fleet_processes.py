"""Two vehicles of a fleet in real time, of two kinds: one of ``sitl``, one by its URL."""

import numpy as np
import pytest

from flightstack.common.strict_toml import dumps
from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from logs.schema.fleet_rows import unpack_neighbours
from logs.verdict.fleet import judge_fleet
from sim.autopilot.ground import ORIGIN_WGS84
from sim.autopilot.profiles import PROFILES
from sim.scenarios import team
from tests.integration.runs import Flying, called
from tests.integration.sim_processes import free_port, verb

TEAM = f"""
name = "two_cross"
description = "Two vehicles fly to each other's side of the room"
base = "paper_static_1"
[start]
kind = "hover"
[onboard.fleet]
members = [1, 2]
id = 1
[[member]]
target.position_m = [1.0, 0.0]
start.offset_m = [-2.2, 0.1, 1.0]
[[member]]
onboard.fleet.id = 2
onboard.vehicle.origin_wgs84 = {list(ORIGIN_WGS84)}
target.position_m = [-1.0, 0.0]
start.offset_m = [2.2, -0.1, 1.0]
"""
OTHER = "ardupilot"


@pytest.mark.xdist_group("real-time")
def test_two_kinds_of_vehicles_hear_each_other_land_and_replay(tmp_path):
    (tmp_path / "team.toml").write_text(TEAM)
    _, (scenario, seed) = team.load(tmp_path / "team.toml").singles(1)
    (tmp_path / "cf2.toml").write_text(dumps(scenario))
    place, out = f"127.0.0.1:{free_port()}", tmp_path / "out"
    options = ("--seed", 1, "--duration", 90, "--member", f"2=udpout:{place}")
    run = Flying(out, "--scenario", tmp_path / "team.toml", *options)
    try:
        run.wait_for("robots: ")
        values = PROFILES[OTHER].set_before_flight | {PROFILES[OTHER].station_id: 2}
        parameters = [f"{name}={value:g}" for name, value in values.items()]
        words = ("--scenario", tmp_path / "cf2.toml", "--seed", seed, "--namespace", "cf2", "--system-id", 2)
        wires = ("--url", f"udpin:{place}", "--connect", run.lines[-1].split()[1], "--profile", OTHER)
        with verb("vehicle", *words, *wires, *(w for p in parameters for w in ("--parameter", p))):
            assert run.end() == 0, "\n".join(run.lines)
    finally:
        run.kill()
    fleet, log = load_fleet(out / "flight.mcap"), LogFile(out / "flight.mcap")
    verdict = judge_fleet(fleet)
    assert [each.judged_from for each in verdict.members.values()] == ["truth", "estimate"]
    assert verdict.collisions is None  # nobody knows where the other one truly was
    assert log.metadata()["cf2/preflight"]["profile"] == OTHER
    for n in (1, 2):
        result = replay(out / "flight.mcap", member=f"cf{n}")
        assert result.equal, result.outputs.first + result.states.first
        messages = log.messages({f"/cf{n}/controller/neighbours"})
        heard = [word for message in messages for word in unpack_neighbours(message.data)]
        assert {word.id for word in heard} == {3 - n}
        bounds_s = np.array([word.clock_bound_s for word in heard])
        assert np.median(bounds_s) < 0.02  # half a tick and what the machine is late by


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--scenario", "fleet_3", "--member", "4=udpin:127.0.0.1:1"), "found 4; allowed are 1 to 3"),
        (("--scenario", "fleet_3", "--member", "two=udpin:127.0.0.1:1"), "N=URL is needed"),
        (("--scenario", "field", "--member", "1=udpin:127.0.0.1:1"), "for a scenario of several vehicles"),
        (
            ("--scenario", "fleet_3", "--lockstep", "--member", "2=udpin:127.0.0.1:1"),
            "a vehicle from elsewhere waits for nobody",
        ),
    ],
)
def test_members_that_cannot_fly_from_elsewhere_are_refused(words, why, tmp_path):
    done = called("sitl", *words, "--out", tmp_path / "out")
    assert done.code == 2
    assert why in done.err
