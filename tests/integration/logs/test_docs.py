"""Tests that each command of README and docs runs as documented, and that a log has the listed topics."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest

from logs.reader.flight import load_flight
from logs.reader.reader import LogFile
from tests.integration.runs import WALL_MAX_S, Result, flightstack
from tests.processes.bounded import killed, line_of
from tests.unit.target.ros2_helpers import on_free_ports

ROOT = Path(__file__).parents[3]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md"), key=lambda p: (p.parent.name != "start", p)),
]
BIN = Path(os.sys.executable).parent
APART = ("target", "vehicle", "fly")
RUN_HERE = ("scenarios", "sitl", "report", "compare", "replay", "check", "campaign", "python")


# pages whose commands share the folder ``runs/``, in this order; every other page is independent
STORY = ("README.md", "first_flight.md", "report.md")


def commands(pages=PAGES):
    """Return the commands in blocks marked ``sh``, in order, with continuation lines joined."""
    found = []
    for page in pages:
        for block in re.findall(r"^```sh\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            found += [line for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    return found


def verb(command):
    words = shlex.split(command)
    return words[1] if words[0].endswith("flightstack") else Path(words[0]).name


def run(command, cwd):
    """Run one command in a folder; the folder has links to the .venv of the tests, docs and examples."""
    if not (cwd / ".venv").exists():
        (cwd / ".venv").symlink_to(BIN.parent)
        for folder in ("docs", "examples"):
            (cwd / folder).symlink_to(ROOT / folder)
    words = shlex.split(command)
    if Path(words[0]).name == "flightstack":
        return flightstack(*words[1:], cwd=cwd)
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=WALL_MAX_S, check=False)
    return Result(done.returncode, done.stdout, done.stderr)


def real_time(command):
    return verb(command) == "sitl" and "--lockstep" not in command


def run_each(chosen, cwd):
    """Run each command once; each must succeed."""
    for command in chosen:
        done = run(command, cwd)
        assert done.code == 0, (command, done.out, done.err)
        if "--json" in command:
            assert done.json["outcome"] == "landed"


def run_here(pages):
    """Return the commands, without duplicates, that a test can run unchanged and in a short time."""
    return [*dict.fromkeys(c for c in commands(pages) if verb(c) in RUN_HERE and not real_time(c))]


def stories():
    """Return the groups of pages whose commands share a folder: those of ``STORY``, then each other page."""
    told = [page for name in STORY for page in PAGES if page.name == name]
    return [told, *([page] for page in PAGES if page not in told and run_here([page]))]


@pytest.mark.parametrize("pages", stories(), ids=lambda pages: pages[0].stem)
def test_the_commands_that_fly_in_lockstep_report_and_compare(pages, tmp_path):
    run_each(run_here(pages), tmp_path)
    if pages == stories()[0]:
        assert (tmp_path / "runs/first/report.html").stat().st_size > 100_000


@pytest.mark.xdist_group("real-time")
def test_the_commands_that_fly_in_real_time(tmp_path):
    run_each(filter(real_time, commands()), tmp_path)


@pytest.mark.xdist_group("real-time")
def test_the_parts_apart_land(tmp_path):
    (tmp_path / "runs").mkdir()
    page = on_free_ports("\n".join(commands()))
    parts = {verb(c): c for c in page.splitlines() if verb(c) in APART}
    assert list(parts) == list(APART)
    run(f"{BIN}/python --version", tmp_path)  # ``run`` creates the .venv of the folder
    running = []
    try:
        for name, command in parts.items():
            text = (tmp_path / f"{name}.txt").open("w")
            running.append(
                subprocess.Popen(
                    shlex.split(command), cwd=tmp_path, stdout=subprocess.PIPE, stderr=text, text=True
                )
            )
            if name == "vehicle":  # the target is ready only after a client has subscribed
                ready = line_of(running[-1].stdout)
                assert ready.startswith("ready"), (tmp_path / f"{name}.txt").read_text()
        said, _ = running[-1].communicate(timeout=WALL_MAX_S)
        assert running[-1].returncode == 0, said + (tmp_path / "fly.txt").read_text()
        assert "LANDED: motors off" in said
    finally:
        for process in reversed(running):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=20.0)
            killed(process)
    flight = load_flight(tmp_path / "runs/real/flight.mcap")
    assert flight.complete
    assert len(flight.steps.tick) > 500
    assert (tmp_path / "runs/real/report.html").exists()


@pytest.mark.xdist_group("real-time")
def test_make_fly_lands():
    if shutil.which("make") is None or not (ROOT / ".venv").exists():
        pytest.skip("make fly needs make and the checkout's own .venv")
    assert "make fly" in commands()
    assert "make test" in commands()  # not run here, because this command runs this test
    done = subprocess.run(
        ["make", "fly"], cwd=ROOT, capture_output=True, text=True, timeout=WALL_MAX_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "landed" in done.stdout
    log, report = (re.search(rf"^{what}\s+(\S+)", done.stdout, re.MULTILINE)[1] for what in ("log", "report"))
    assert load_flight(ROOT / log).complete
    assert (ROOT / report).stat().st_size > 100_000


# topics that are recorded only with a fleet, or if the configuration has a certain table
WITH_TABLE = {"/cf1/controller/power", "/cf1/controller/neighbours", "/cf1/fleet/status", "/fleet/pairs"}
DECODED = "/cf1/mavlink/sysS/compC/MESSAGE"  # line of the page for many topics
DECODED_TOPIC = re.compile(r"/cf1/mavlink/sys\d+/comp\d+/[A-Z0-9_]+")
PAGE = ROOT / "docs/reference/logs.md"
log_docs = pytest.mark.xdist_group("log docs")  # these tests share a flight


@pytest.fixture(scope="module")
def folder(flown, tmp_path_factory):
    """Return a folder with the logs that the commands in docs name; all are copies of one flight."""
    path = tmp_path_factory.mktemp("docs")
    flight = flown("paper_static_1")
    assert flight.code == 0
    for name in ("first", "second"):
        shutil.copytree(flight.folder, path / "runs" / name)
    (path / ".venv").symlink_to(BIN.parent)
    return path


def table():
    rows = re.findall(r"^\| `(/\S+)` \| `(\S+)` \| (\S+) \|", PAGE.read_text(), re.MULTILINE)
    return {topic: (kind, rate) for topic, kind, rate in rows}


@log_docs
def test_the_table_is_what_a_flight_records(folder):
    log = LogFile(folder / "runs/first/flight.mcap")
    times, recorded = defaultdict(list), {}
    for message in log.messages():
        times[message.topic].append(message.log_time_ns * 1e-9)
        recorded[message.topic] = message.schema
    assert table().keys() >= {DECODED, *WITH_TABLE}
    listed = {topic: kind for topic, (kind, _) in table().items() if topic not in (DECODED, *WITH_TABLE)}
    decoded = {topic for topic in recorded if DECODED_TOPIC.fullmatch(topic)}
    assert "/cf1/mavlink/sys1/comp1/HEARTBEAT" in decoded
    assert listed == {topic: schema for topic, schema in recorded.items() if topic not in decoded}
    stated = {
        topic: float(table()[topic][1]) for topic in listed if table()[topic][1] not in ("all", "events")
    }
    assert len(stated) > 10
    for topic, rate_hz in stated.items():
        at_s = times[topic]
        assert (len(at_s) - 1) / (max(at_s) - min(at_s)) == pytest.approx(rate_hz, rel=0.2), topic
    page = PAGE.read_text()
    for name in log.metadata():
        assert f"`{name}`" in page


@log_docs
def test_the_commands_run(folder):
    lines = re.findall(r"^\.venv/bin/flightstack log .*$", PAGE.read_text(), re.MULTILINE)
    assert {shlex.split(line)[2] for line in lines} == {"info", "verdict", "export", "recover"}
    for line in lines:
        done = subprocess.run(
            shlex.split(line), cwd=folder, capture_output=True, text=True, timeout=WALL_MAX_S, check=False
        )
        assert done.returncode == 0, (line, done.stdout, done.stderr)
