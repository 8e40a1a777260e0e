"""Tests that compiled code and interpreted Python give equal, reproducible results on shared records."""

import json
import math
import os
import subprocess
import sys
import threading
from dataclasses import replace
from typing import Annotated

import pytest

from flightstack.compiled import jit
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Record, cell, new
from flightstack.core.parameters.flight import FlightConfig, Takeoff
from flightstack.core.safety.barrier import Barrier
from sim.clock import TickGrid
from sim.runners.robot import Robot
from sim.scenarios import scenario
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import (
    OdometryLink,
    Start,
    StartKind,
    StateError,
    TargetLink,
    VehicleSpec,
    VelocityLoop,
    Wind,
)
from sim.vehicle.vehicle import VehicleSim

pytestmark = pytest.mark.slow

STEPS = 300


def flight(loop, kind, error=False):
    """Return true states and estimates of a short flight in gusts: a descent or a take-off."""
    mocap = OdometryLink(100.0, 0.005, 0.0, 0.005, 0.02, loss=0.02)
    spec = VehicleSpec(
        velocity_loop=VelocityLoop(loop),
        mocap=mocap,
        mass_spread=0.1,
        thrust_spread=0.1,
        slow_motors=kind == "ground",
        own=StateError() if error else None,
    )
    start = Start(StartKind(kind), offset_m=(0.0, 0.05, 0.03))
    onboard = FlightConfig(Barrier(1.0, 1.5), takeoff=Takeoff(start_offset_m=(-1.0, 0.0, 0.7)))
    wind = Wind(1.0, 0.6)
    sim = VehicleSim(Scenario("test", "", onboard, start=start, vehicle=spec, wind=wind), 5)
    sim.arm()
    climb = -0.2 if kind == "hover" else 0.3
    out = []
    for _ in range(STEPS // 10):
        sim.set_velocity((0.1, 0.0, climb), 0.3)
        sim.advance(10)
        out.append([sim.truth(), sim.estimate()])
    return out


CASES = [(loop.value, kind.value) for loop in VelocityLoop for kind in StartKind]
CASES.append(("pid", "hover", True))


def flat(value):
    if isinstance(value, (list, tuple)):
        return [number for part in value for number in flat(part)]
    return [value]


def drives():
    """Return all states and odometry samples of the robots of all scenarios."""
    out = []
    captured = replace(scenario.load("field"), odometry=TargetLink(50.0, error=StateError()))
    for each in (*map(scenario.load, scenario.names()), captured):
        robot = Robot(each, 3, TickGrid(100))
        for tick in range(STEPS):
            pads, come, samples = robot.run(1, driving=tick > 20)
            out.append([*pads[0].tolist(), come.tolist(), samples.tolist()])
    return out


FLIGHTS, DRIVES = "[flight(*case) for case in CASES]", "drives()"


def in_a_process(what=FLIGHTS, **environment):
    """Return the results computed by a new interpreter, which a test compares with those of this process."""
    here = "from tests.unit.compiled.test_jit import CASES, drives, flight"
    needless = "import sys; assert not {'coverage', 'glfw'} & sys.modules.keys()"
    code = f"import json; {here}; print(json.dumps({what})); {needless}"
    env = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", code], env=env, check=True, capture_output=True, text=True)
    return flat(json.loads(done.stdout))


@pytest.fixture(scope="module")
def compiled():
    return flat([flight(*case) for case in CASES])


def test_plain_python_flies_the_same(compiled):
    plain = in_a_process(NUMBA_DISABLE_JIT="1")
    assert plain == pytest.approx(compiled, abs=1e-9, rel=1e-9, nan_ok=True)
    assert any(isinstance(n, float) and math.isfinite(n) and n not in (0.0, 1.0) for n in plain)


def test_the_robot_drives_the_same_bits_in_plain_python_without_numba():
    """Interpreted code, as in the robot's process, and compiled code give equal states of each robot."""
    assert repr(in_a_process(DRIVES, NUMBA_DISABLE_JIT="1")) == repr(flat(json.loads(json.dumps(drives()))))
    words = ["-m", "flightstack.cli.main", "target", "--scenario", "lab", "--duration", "0.1"]
    done = subprocess.run(
        [sys.executable, "-X", "importtime", *words], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0
    assert "sim.runners.robot" in done.stderr
    assert "numba" not in done.stderr


def test_another_process_flies_the_same_bits(compiled):
    assert repr(in_a_process()) == repr(compiled)


def test_the_cache_belongs_to_these_sources(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    first = jit.cache_directory.__wrapped__()
    assert first.parent == tmp_path
    monkeypatch.setattr(jit, "HERE", tmp_path)
    (tmp_path / "changed.py").write_text("x = 1")
    assert jit.cache_directory.__wrapped__() != first


class Inner(Record):
    values: Annotated[F64, 2]
    on: bool


class Outer(Record):
    count: int
    inner: Inner
    x: float


@jitted
def count(outer):
    outer[0].count += 1
    outer[0].inner.values[0] = outer[0].count


def test_compiled_code_changes_the_same_memory():
    outer = new(Outer)
    for _ in range(3):
        count(cell(outer))
    assert (int(outer.count), float(outer.inner.values[0])) == (3, 3.0)


ADDS = """
import sys, resource
import numpy as np
from flightstack.compiled import jit
def add(x):
    return x[0] + 1.0
add.__module__ = "x"
if sys.argv[1:]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
print(jit.jitted(add)(np.zeros(1)))
"""


def test_a_full_disk_and_damaged_machine_code_only_cost_time(tmp_path):
    """A program returns the right result on a full disk and with empty, truncated or damaged machine code."""
    file = tmp_path / "adds.py"
    file.write_text(ADDS)

    def added(*words):
        place = {"NUMBA_CACHE_DIR": str(tmp_path / "c")}
        done = subprocess.run(
            [sys.executable, "-W", "error", file, *words], env=os.environ | place,
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        return done.stdout, done.stderr

    def code():
        return sorted(each for each in (tmp_path / "c").rglob("*.nb?") if "add" in each.name)

    assert added("full") == ("1.0\n", "")
    assert not code() or not any(each.stat().st_size for each in code())
    assert added() == ("1.0\n", "")
    index, data = sorted(code(), key=lambda each: each.suffix, reverse=True)
    for damaged in (index, data):
        for content in (b"", damaged.read_bytes()[:-20], b"\xff" * 500):
            damaged.write_bytes(content)
            assert added() == ("1.0\n", "")
            assert damaged.read_bytes() != content  # the machine code was compiled and stored again


def _twice(x):
    return 2.0 * x


def test_machine_code_that_a_second_process_compiled_is_loaded(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    twice = jit.jitted(_twice)
    jit.at_once(lambda: None, lambda: twice(1.0))
    assert twice(2.0) == 4.0
    assert sum(twice.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("apart", [lambda: 1 / 0, lambda: threading.Event().wait()])
def test_a_second_process_that_fails_or_hangs_does_not_stop_the_first(tmp_path, monkeypatch, apart):
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(jit, "_APART_MAX_S", 0.1)
    done = []
    jit.at_once(lambda: done.append(True), apart)
    assert done == [True]


def test_without_room_for_a_second_process_the_first_goes_on(tmp_path, monkeypatch):
    def refuse():
        raise BlockingIOError("Resource temporarily unavailable")

    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(jit.os, "fork", refuse)
    done = []
    jit.at_once(lambda: done.append(True), lambda: None)
    assert done == [True]


def test_without_a_cache_directory_no_second_process_is_started(monkeypatch):
    monkeypatch.setattr(jit, "cache_directory", lambda: None)
    monkeypatch.setattr(jit.os, "fork", lambda: pytest.fail("forked"))
    done = []
    jit.at_once(lambda: done.append(True), lambda: None)
    assert done == [True]
