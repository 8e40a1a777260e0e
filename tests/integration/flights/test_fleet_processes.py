"""Two vehicles of a fleet in real time, each with an onboard process of its own, over Zenoh and MAVLink."""

from contextlib import ExitStack

import numpy as np
import pytest

from flightstack.common.strict_toml import dumps
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from logs.schema.fleet_rows import unpack_neighbours
from sim.scenarios import team
from tests.integration.runs import WALL_MAX_S
from tests.integration.sim_processes import free_port, verb

TEAM = """
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
target.position_m = [-1.0, 0.0]
start.offset_m = [2.2, -0.1, 1.0]
"""


@pytest.mark.xdist_group("real-time")
def test_two_processes_hear_each_other_land_and_replay(tmp_path):
    (tmp_path / "team.toml").write_text(TEAM)
    members = [scenario for scenario, _ in team.load(tmp_path / "team.toml").singles(1)]
    endpoints = [f"tcp/127.0.0.1:{free_port()}" for _ in members]
    with ExitStack() as stack:
        onboard = []
        for n, (scenario, endpoint) in enumerate(zip(members, endpoints, strict=True), 1):
            folder = tmp_path / f"cf{n}"
            folder.mkdir()
            (folder / "scenario.toml").write_text(dumps(scenario))
            (folder / "onboard.toml").write_text(dumps(scenario.onboard))
            where = ("--scenario", folder / "scenario.toml", "--namespace", f"cf{n}", "--connect", endpoint)
            _, ready = stack.enter_context(verb("vehicle", *where, "--url", "udpin:127.0.0.1:0"))
            stack.enter_context(verb("target", *where, ready=False))
            child, _ = stack.enter_context(
                verb(
                    "onboard", "--config", folder / "onboard.toml",
                    "--vehicle", ready.removeprefix("ready ").replace("udpin", "udpout"),
                    "--target", f"cf{n}/target/odom", "--listen", endpoint,
                    *(("--connect", endpoints[0]) if n > 1 else ()),
                    "--duration", "90", cwd=folder,
                )
            )  # fmt: skip
            onboard.append(child)
        for child in onboard:
            said, problems = child.communicate(timeout=WALL_MAX_S)
            assert child.returncode == 0, said + problems
            assert "LANDED: motors off" in said
    for n in (1, 2):
        (log,) = (tmp_path / f"cf{n}").glob("runs/*/flight.mcap")
        result = replay(log)
        assert result.equal, result.outputs.first + result.states.first
        messages = LogFile(log).messages({f"/cf{n}/controller/neighbours"})
        heard = [word for message in messages for word in unpack_neighbours(message.data)]
        assert {word.id for word in heard} == {3 - n}
        bounds_s = np.array([word.clock_bound_s for word in heard])
        assert np.median(bounds_s) < 0.02  # half a tick and what the machine is late by
