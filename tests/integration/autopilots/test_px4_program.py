"""A real PX4 as a child process: made ready, asked, ended; skipped where there is none."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.plant import Px4Plant
from sim.px4.program import InstanceClaim, Px4Error, Px4Model, Px4Program, find_px4
from sim.scenarios.scenario import load
from tests.px4_program import px4_or_skip

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.xdist_group("real-time")
PATIENCE_S = 120.0  # the first run on a machine compiles


@pytest.fixture
def instance():
    claim = InstanceClaim()
    yield claim.number
    claim.close()


@contextmanager
def flying(folder, instance, scenario, *more):
    """PX4 with the parameters of the scenario's vehicle, on the plant of px4-sim."""
    loaded = load(scenario)
    poses = loaded.vehicle.mocap if "--mocap" in more else None
    wanted = parameters(params.load(loaded.vehicle.airframe), poses)
    px4 = Px4Program(px4_or_skip(), folder, Px4Model.NONE_IRIS, instance=instance, parameters=wanted)
    words = ["px4-sim", "--scenario", scenario, "--once", "--tcp", f"127.0.0.1:{px4.simulator_port}", *more]
    simulator = subprocess.Popen([sys.executable, "-m", "flightstack.cli.main", *words], cwd=ROOT)
    try:
        yield px4, wanted
    finally:
        px4.end()
        simulator.wait(PATIENCE_S)


@pytest.mark.parametrize(("scenario", "more"), [("large", ()), ("grid", ("--mocap",))])
def test_is_ready_with_the_parameters_wanted_and_counts_from_the_origin_of_the_room(
    tmp_path, instance, scenario, more
):
    with flying(tmp_path, instance, scenario, *more) as (px4, wanted):
        px4.wait_ready(PATIENCE_S)
        assert "Preflight check: OK" in px4.console("commander", "check")
        for name, value in wanted.items():
            px4.console("param", "compare", name, str(value))  # raises where it differs
        said = px4.console("listener", "vehicle_local_position", "-n", "1").splitlines()
        place = {words[0]: words[1] for words in map(str.split, said) if len(words) > 1}
        east, north, _ = Px4Plant(load(scenario), 0).body().position_enu_m
        assert float(place["y:"]) == pytest.approx(east, abs=0.1)  # NED
        assert float(place["x:"]) == pytest.approx(north, abs=0.1)


def test_an_instance_that_runs_is_not_claimed_and_not_started_twice(tmp_path, instance):
    first = Px4Program(px4_or_skip(), tmp_path / "first", Px4Model.NONE_IRIS, instance=instance)
    try:
        until_s = time.monotonic() + PATIENCE_S
        while "Waiting for simulator" not in first.output.read_text() and time.monotonic() < until_s:
            time.sleep(0.05)
        second = Px4Program(px4_or_skip(), tmp_path / "second", Px4Model.NONE_IRIS, instance=instance)
        with pytest.raises(Px4Error, match="already running"):
            second.wait_ready(PATIENCE_S)
        assert second.end() != 0
        assert first.alive()
    finally:
        first.end()


def test_a_px4_without_a_simulator_is_given_up_with_its_last_lines(tmp_path, instance):
    px4 = Px4Program(px4_or_skip(), tmp_path, Px4Model.NONE_IRIS, instance=instance)
    try:
        with pytest.raises(Px4Error, match="Waiting for simulator"):
            px4.wait_ready(3.0)
        os.killpg(px4.process.pid, signal.SIGSTOP)  # not even then does its end take long
        began_s = time.monotonic()
        px4.end()
        assert time.monotonic() - began_s < 10.0
        with pytest.raises(Px4Error, match="has ended"):
            px4.console("commander", "check")
    finally:
        px4.end()


def _members(group: int) -> list[str]:
    """Command lines of the processes of a process group that are no zombies."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, its_group = stat.read_text().rpartition(") ")[2].split()[:3]
            if int(its_group) == group and state not in "ZX":
                found.append(stat.with_name("cmdline").read_text().replace("\0", " "))
    return found


@pytest.mark.parametrize("after", [1, 2, 4])  # processes: the shell, PX4, its start script with a command
def test_dies_with_its_parent(tmp_path, instance, after):
    code = (
        "import sys, time; from pathlib import Path; from sim.px4.program import Px4Model, Px4Program; "
        "p = Px4Program(Path(sys.argv[1]), Path(sys.argv[2]), Px4Model.NONE_IRIS, instance=int(sys.argv[3]));"
        "print(p.process.pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, px4_or_skip(), tmp_path, str(instance)],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    group = int(parent.stdout.readline())
    until_s = time.monotonic() + PATIENCE_S
    while len(_members(group)) < after and time.monotonic() < until_s:
        time.sleep(0.001)
    parent.kill()
    parent.communicate()
    while left := _members(group):
        assert time.monotonic() < until_s, f"PX4 outlived its parent: {left}"
        time.sleep(0.05)


def test_places_without_a_px4_are_refused_with_what_is_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match="no PX4 program found"):
        find_px4(tmp_path)
    (tmp_path / "px4").write_bytes(b"")
    (tmp_path / "px4").chmod(0o755)
    with pytest.raises(FileNotFoundError, match="its folder etc"):
        find_px4(tmp_path)
    (tmp_path / "etc").mkdir()
    with pytest.raises(FileNotFoundError, match=r"px4-alias\.sh"):
        find_px4(tmp_path / "px4")
    (tmp_path / "px4-alias.sh").write_text("")
    assert find_px4(tmp_path).binary == tmp_path / "px4"
    with pytest.raises(ValueError, match="0 to 9"):
        Px4Program(tmp_path, tmp_path, Px4Model.NONE_IRIS, instance=10)
