"""docs/reference/logs.md: its table is a recorded log, and its commands run as they stand there."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.integration.logs.test_readme import BIN, ROOT
from tests.integration.runs import WALL_MAX_S, flightstack

DECODED = "/cf1/mavlink/sysS/compC/MESSAGE"  # the page's one line for many topics
DECODED_TOPIC = re.compile(r"/cf1/mavlink/sys\d+/comp\d+/[A-Z0-9_]+")
PAGE = ROOT / "docs/reference/logs.md"
pytestmark = pytest.mark.xdist_group("log docs")  # they share a flight


@pytest.fixture(scope="module")
def folder(flown, tmp_path_factory):
    """Where the commands find the logs they name: one flight, as that two are equal is tested elsewhere."""
    path = tmp_path_factory.mktemp("docs")
    flight = flown("paper_static_1")
    assert flight.code == 0
    for name in ("first", "second"):
        shutil.copytree(flight.folder, path / "runs" / name)
    (path / ".venv").symlink_to(BIN.parent)
    return path


def table():
    """Topic -> (type, rate) of the page."""
    rows = re.findall(r"^\| `(/\S+)` \| `(\S+)` \| (\S+) \|", PAGE.read_text(), re.MULTILINE)
    return {topic: (kind, rate) for topic, kind, rate in rows}


def test_the_table_is_what_a_flight_records(folder):
    found = json.loads(flightstack("log", "info", "--json", folder / "runs/first/flight.mcap").out)
    recorded = {t["topic"]: t for t in found["topics"]}
    listed = {topic: kind for topic, (kind, _) in table().items() if topic != DECODED}
    decoded = {topic for topic in recorded if DECODED_TOPIC.fullmatch(topic)}
    assert DECODED in table()
    assert "/cf1/mavlink/sys1/comp1/HEARTBEAT" in decoded
    assert listed == {topic: t["schema"] for topic, t in recorded.items() if topic not in decoded}
    stated = {topic: float(rate) for topic, (_, rate) in table().items() if rate not in ("all", "events")}
    assert len(stated) > 10
    for topic, rate_hz in stated.items():
        assert recorded[topic]["rate_hz"] == pytest.approx(rate_hz, rel=0.2), topic
    page = PAGE.read_text()
    for name in found["metadata"]:
        assert f"`{name}`" in page


def test_the_commands_run(folder):
    lines = re.findall(r"^\.venv/bin/flightstack log .*$", PAGE.read_text(), re.MULTILINE)
    verbs = {"info", "verdict", "diff", "cut", "filter", "recover", "export"}
    assert {shlex.split(line)[2] for line in lines} == verbs
    for line in lines:
        done = subprocess.run(
            shlex.split(line), cwd=folder, capture_output=True, text=True, timeout=WALL_MAX_S, check=False
        )
        assert done.returncode == 0, (line, done.stdout, done.stderr)
        if "--out" in line:
            assert (folder / shlex.split(line)[-1]).stat().st_size > 1000
    assert not [p for p in Path(folder / "runs/first").iterdir() if p.name.endswith(".part")]
