"""Three kinds of vehicles in one fleet in real time: simulated, a real PX4, a Crazyflie with its bridge."""

import contextlib
import itertools
import math
import re
import shlex
import subprocess
import time
from pathlib import Path

import click
import numpy as np
import pytest

from flightstack.cli.main import main
from logs.reader.flight import load_fleet
from logs.reader.reader import LogFile
from logs.replay.replay import replay
from logs.schema.controller_rows import unpack_neighbours
from logs.schema.rows import FleetWordRow
from logs.verdict.verdict import judge_fleet
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import InstanceClaim, Px4Error, Px4Model, Px4Program
from sim.scenarios.team import load
from tests.integration.runs import Flying
from tests.integration.sim_processes import verb
from tests.integration.wires.bridge_processes import member_behind_the_bridge
from tests.processes.ports import free_port
from tests.px4_place import px4_or_skip

ROOT = Path(__file__).parents[3]
TEAM, PAGE = ROOT / "examples" / "mixed_fleet.toml", ROOT / "docs" / "how_to" / "mixed_fleet.md"
SEED, PX4, CRAZYFLIE = 1, 2, 3
KINDS = {1: "sitl", PX4: "px4", CRAZYFLIE: "crazyflie"}
READY_S = 200.0  # time-out until PX4 can arm, also on a busy machine
TOUCHED = re.compile(r"touched the pad at .* s, (\S+) m east and (\S+) m north")


def claimed(numbers):
    """Reserve an instance number of PX4; wait while another flight uses it."""
    until_s = time.monotonic() + READY_S
    while True:
        with contextlib.suppress(Px4Error):
            return InstanceClaim(numbers)
        if time.monotonic() >= until_s:
            names = ["pgrep", "--list-full", "px4"]
            running = subprocess.run(names, capture_output=True, text=True, check=False).stdout
            pytest.fail(f"PX4 instances {numbers} stay in use; these run:\n{running}")
        time.sleep(0.5)  # polls a lock of other processes, which has no event


@contextlib.contextmanager
def px4_on_its_simulator(folder, instance, robots):
    """Run PX4 on a body whose deck follows the robot of its member.

    Yields the simulator's output, filled after its end.
    """
    scenario, _ = load(TEAM).one(SEED, PX4)
    wanted = parameters(params.load(scenario.vehicle.airframe), scenario.vehicle.mocap)
    words = ("--scenario", TEAM, "--seed", SEED, "--member", PX4, "--mocap", "--once", "--connect", robots)
    with verb("px4-sim", *words, "--tcp", f"127.0.0.1:{4560 + instance}") as (child, _):
        px4 = Px4Program(px4_or_skip(), folder, Px4Model.NONE_IRIS, instance=instance, parameters=wanted)
        said = []
        try:
            px4.wait_ready(READY_S)
            yield said
        finally:
            px4.end()
        said += child.communicate(timeout=READY_S)[0].splitlines()  # it ends with its PX4


def places(log):
    """Return the reported time and position of each member, by its number."""
    told = {number: [] for number in KINDS}
    for message in log.messages({f"/cf{number}/fleet/word" for number in KINDS}):
        word = FleetWordRow.unpack(message.data)
        told[word.id].append((word.stamp_ns * 1e-9, *word.position_enu_m))
    return {number: np.array(rows) for number, rows in told.items()}


def least_rho(one, other, fleet):
    """Return the smallest ellipsoid norm between two members, from the reported positions."""
    t = np.arange(max(one[0, 0], other[0, 0]), min(one[-1, 0], other[-1, 0]), 0.02)
    x, y, z = (np.interp(t, one[:, 0], one[:, k]) - np.interp(t, other[:, 0], other[:, k]) for k in (1, 2, 3))
    return float(np.sqrt((x * x + y * y) / fleet.radius_xy_m**2 + z * z / fleet.radius_z_m**2).min())


@pytest.mark.xdist_group("real-time")
@pytest.mark.xdist_group("stream 0")
def test_three_kinds_cross_land_and_replay(tmp_path):
    px4_or_skip()
    bridge_at, out = f"127.0.0.1:{free_port(udp=True)}", tmp_path / "out"
    with contextlib.closing(claimed((PX4 - 1,))) as claim:  # the system id is the instance number + 1
        urls = {PX4: f"udpin:127.0.0.1:{14540 + claim.number}", CRAZYFLIE: f"udpout:{bridge_at}"}
        members = [word for number, url in urls.items() for word in ("--member", f"{number}={url}")]
        run = Flying(out, "--scenario", TEAM, "--seed", SEED, *members)
        try:
            robots = run.until("robots: ").split()[1]
            crazyflie = (*load(TEAM).one(SEED, CRAZYFLIE), CRAZYFLIE, f"udpin:{bridge_at}", robots)
            with (
                member_behind_the_bridge(*crazyflie) as plant,
                px4_on_its_simulator(tmp_path / "px4", claim.number, robots) as said,
            ):
                assert run.end() == 0, "\n".join(run.lines)
                truth = plant.vehicle.truth()
        finally:
            run.kill()
    pad_radius_m = load(TEAM).member[0].target.pad_radius_m
    assert math.dist(truth.position_enu_m[:2], truth.pad_position_enu_m[:2]) < pad_radius_m
    (touched,) = filter(None, map(TOUCHED.match, said))
    assert math.hypot(*map(float, touched.groups())) < pad_radius_m
    fleet, log = load_fleet(out / "flight.mcap"), LogFile(out / "flight.mcap")
    assert [each.judged_from for each in judge_fleet(fleet).members.values()] == ["truth", *["estimate"] * 2]
    for number, kind in KINDS.items():
        assert log.metadata()[f"cf{number}/preflight"]["profile"] == kind
        result = replay(out / "flight.mcap", member=f"cf{number}")
        assert result.equal, result.outputs.first + result.states.first
        messages = log.messages({f"/cf{number}/controller/neighbours"})
        heard = {word.id for message in messages for word in unpack_neighbours(message.data)}
        assert heard == KINDS.keys() - {number}
    told, settings = places(log), load(TEAM).member[0].onboard.fleet
    for one, other in itertools.combinations(KINDS, 2):
        assert least_rho(told[one], told[other], settings) > 1.0
    assert not any(b" jumps by " in message.data for message in log.messages({"/rosout"}))


def test_the_commands_of_the_page_are_those_of_the_verbs_and_name_the_members_of_the_example():
    blocks = re.findall(r"^```console\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    commands = [line.removeprefix("$ ") for line in "".join(blocks).splitlines() if line.startswith("$ ")]
    ours = [words[1:] for words in map(shlex.split, commands) if words[0] == "flightstack"]
    assert {words[0] for words in ours} == {"check", "sitl", "px4-sim", "bridge"}
    for words in ours:
        context, rest = main.make_context("flightstack", list(words)), words
        while isinstance(context.command, click.Group):
            name, command, rest = context.command.resolve_command(context, rest)
            context = command.make_context(name, list(rest), parent=context)  # rejects unknown options
    (sitl,) = [words for words in ours if words[0] == "sitl"]
    given = {int(text.partition("=")[0]) for text in sitl if re.match(r"\d=", text)}
    assert given == {PX4, CRAZYFLIE}
    assert len(load(TEAM).member) == len(KINDS)
