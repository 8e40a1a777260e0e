"""Tests that examples and blocks of the documentation run; examples import only the public interface."""

import ast
import csv
import math
import re
import signal
import subprocess
import sys
import tomllib
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import plotly.graph_objects as go
import pytest

import flightstack as fs
from bridge.target.odometry import raw_sample
from bridge.zenoh.zenoh_link import drain, open_session, ring_subscriber
from flightstack.config import load as load_config
from logs.reader.flight import load_flight
from sim.runners.published_robot import deck_state
from sim.scenarios.scenario import load as load_scenario
from tests.integration.runs import WALL_MAX_S, flightstack
from tests.integration.sim_processes import verb
from tests.processes.bounded import PATIENCE_S, killed, wait_for
from tests.processes.ports import free_endpoint, free_port
from tests.processes.started import Started
from tests.unit.target.ros2_helpers import ODOMETRY, decode

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples"
PAGE = (ROOT / "docs" / "reference" / "python.md").read_text()
ROOMS = {"flightstack", "bridge", "sim", "logs"}


def run(name, *words, cwd=ROOT):
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, *map(str, words)],
        cwd=cwd, capture_output=True, text=True, timeout=WALL_MAX_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@contextmanager
def running(name, *words):
    """Run an example and end it by Ctrl-C; its exit status must be 0, and it must print no error."""
    child = subprocess.Popen([sys.executable, EXAMPLES / name, *words], cwd=ROOT, stderr=subprocess.PIPE)
    try:
        yield child
        child.send_signal(signal.SIGINT)
        _, said = child.communicate(timeout=PATIENCE_S)
        assert (child.returncode, said) == (0, b"")
    finally:
        if child.poll() is None:
            child.kill()
            child.communicate(timeout=PATIENCE_S)


def imports():
    """Return (module, name) of each import from this project in the examples, also of each ``fs.NAME``."""
    found = set()
    for file in EXAMPLES.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                rooms = {alias.name for alias in node.names if alias.name.split(".")[0] in ROOMS}
                assert rooms <= {"flightstack"}
            elif isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in ROOMS:
                found |= {(node.module, alias.name) for alias in node.names}
            elif isinstance(node, ast.Attribute) and getattr(node.value, "id", "") == "fs":
                found.add(("flightstack", node.attr))
    return found


LISTED = re.findall(r"^\| `([\w.]+)` \| `(\w+)` \| .+ \|$", PAGE, re.MULTILINE)


def test_the_page_lists_what_the_library_offers_and_the_examples_import_nothing_else():
    assert len(LISTED) == len(set(LISTED))
    library = {("flightstack", name) for name in fs.__all__}
    assert {each for each in LISTED if each[0] == "flightstack"} == library
    assert imports() <= set(LISTED)
    for module, name in LISTED:
        thing = getattr(import_module(module), name)
        assert thing.__doc__, f"{module}.{name}: help() shows no text"
        if isinstance(thing, type) and thing.__module__ in (module, f"flightstack.api.{module}"):
            for member, value in vars(thing).items():
                if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                    assert value.__doc__, f"{module}.{name}.{member}: help() shows no text"


def test_a_landing_lands():
    out = run("landing.py", "lab", 3)
    assert re.search(r"^landed: touched \d\.\d cm from the centre", out, re.MULTILINE)
    assert [line.split()[-1] for line in out.splitlines()[:5]] == [
        "WAIT", "APPROACH", "LAND", "TOUCHDOWN", "LANDED"
    ]  # fmt: skip


def test_a_controller_of_ones_own_and_two_environments_land():
    out = run("own_controller.py", 1)
    assert re.search(r"^seed 0: touched \d", out, re.MULTILINE)
    out = run("environment.py")
    assert "observations (2, 13), actions (2, 3)" in out
    assert sorted(line.split(",")[0] for line in out.splitlines()[1:]) == [
        "environment 0: landed", "environment 1: landed"
    ]  # fmt: skip


def test_filters_and_sweeps_are_flown(tmp_path):
    assert run("own_filter.py").startswith("landed: ")
    assert "violations" in run("sweep.py", 1, tmp_path / "sweep.html")
    assert (tmp_path / "sweep.html").stat().st_size > 1000


def test_a_log_becomes_a_table(flown, tmp_path):
    flight = flown("paper_static_1")
    out = run("log_to_frame.py", flight.log, tmp_path / "flight.csv")
    steps = load_flight(flight.log).steps
    assert f"{len(steps.t_s)} steps" in out
    with (tmp_path / "flight.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(steps.t_s)
    assert [float(row["command_enu_m_s_x"]) for row in rows] == steps.command_enu_m_s[:, 0].tolist()


@pytest.mark.xdist_group("real-time")
def test_the_target_drives_a_circle_and_says_so():
    endpoint = free_endpoint()
    samples, pads = [], []
    keys = ("--key", "demo/odom", "--deck", "demo/deck")
    with running("publish_target.py", *keys, "--speed", "0.5", "--listen", endpoint):
        session = open_session([], [endpoint])
        try:
            subscriber, deck = (ring_subscriber(session, key) for key in ("demo/odom", "demo/deck"))

            def enough():
                samples.extend(map(raw_sample, drain(subscriber)))
                pads.extend(deck_state(sample.payload.to_bytes()) for sample in drain(deck))
                return len(samples) >= 60

            wait_for(enough, "60 samples")
        finally:
            session.close()
    messages = [decode(ODOMETRY, sample.payload) for sample in samples]  # an independent codec
    assert {b.sequence - a.sequence for a, b in pairwise(samples)} == {1}
    times_s = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages]
    places = [(m.pose.pose.position.x, m.pose.pose.position.y) for m in messages]
    assert {(m.header.frame_id, m.child_frame_id) for m in messages} == {("map", "target")}
    for x, y in places:
        assert math.hypot(x, y - 1.0) == pytest.approx(1.0)
    way_m = sum(math.dist(a, b) for a, b in pairwise(places))
    assert way_m / (times_s[-1] - times_s[0]) == pytest.approx(0.5, rel=0.02)
    # the deck follows the same circle; its first or last message may be lost
    assert len({pad.position_enu_m[:2] for pad in pads} & set(places)) >= 50
    last = messages[-1]
    heading_rad = 2.0 * math.atan2(last.pose.pose.orientation.z, last.pose.pose.orientation.w)
    assert (math.sin(heading_rad), 1.0 - math.cos(heading_rad)) == pytest.approx(places[-1])
    assert last.twist.twist.linear.x == pytest.approx(0.5)


@pytest.mark.xdist_group("real-time")
def test_the_target_is_landed_on(tmp_path):
    zenoh, url = free_endpoint(), f"127.0.0.1:{free_port(udp=True)}"
    vehicle = ("vehicle", "--scenario", "paper_static_2", "--url", f"udpin:{url}")
    robot = ("publish_target.py", "--key", "demo/odom", "--speed", "0", "--listen", zenoh)
    with verb(*vehicle), running(*robot):
        words = ("--vehicle", f"udpout:{url}", "--target", "demo/odom", "--connect", zenoh)
        words += ("--config", "crazyflie", "--no-record", "--json", "--out", tmp_path)
        done = flightstack("fly", *words)
    assert (done.code, done.json["outcome"]) == (0, "landed"), done.out + done.err
    # without a log, only the outcome that the onboard process reports is available
    assert (done.json["log"], done.json["touchdown_error_m"]) == (None, None)
    assert not list(tmp_path.glob("*.mcap"))


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(language):
    """Yield (page and number, text) for every block of a language."""
    for page in PAGES:
        found = re.findall(rf"^```{language}[^\n]*\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        yield from ((f"{page.relative_to(ROOT)}-{n}", text) for n, text in enumerate(found))


# other blocks need a vehicle; the programs for MAVSDK and for subscribers have their own tests
LIBRARY = {name: text for name, text in blocks("python") if "import flightstack as fs" in text}
TABLES = dict(blocks("toml"))


@pytest.mark.parametrize("name", LIBRARY)
def test_a_program_of_a_page_runs(name, tmp_path):
    child = Started(run_program, LIBRARY[name], name, cwd=tmp_path)  # without threads: campaigns may fork
    try:
        _, said = child.communicate(WALL_MAX_S)
    finally:
        killed(child)
    assert child.returncode == 0, said


def run_program(text, name):
    go.Figure.show = lambda figure: figure.to_json()
    exec(compile(text, name, "exec"), {"__name__": "page"})


@pytest.mark.parametrize("name", TABLES)
def test_a_file_of_a_page_is_read(name, tmp_path):
    table = tomllib.loads(TABLES[name])
    assert table
    file = tmp_path / "page.toml"
    file.write_text(TABLES[name])
    if "base" not in table or "crazyflie21" in table["base"]:
        return
    scenario = "description" in table
    loaded = load_scenario(file) if scenario else load_config(file)
    assert loaded is not None
