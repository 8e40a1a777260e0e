"""Tests that programs of other projects open a recorded log and decode its data."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype

from logs.reader.reader import LogFile
from logs.schema.mavlink import unpack_mavlink
from tests.integration.runs import COMMAND, entities, flightstack, rrd_reader
from tests.processes.bounded import killed, lines_of

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.xdist_group("viewers")  # these tests share a flight
LAYOUTS = ROOT / "docs/how_to/layouts"
RERUN = Path(sys.executable).parent / "rerun"
PATIENCE_S = 180.0


@pytest.fixture(scope="module")
def log(flown):
    flight = flown("paper_moving_1")
    assert flight.code == 0
    return flight.log


@pytest.fixture(scope="module")
def bag(log):
    """Return, by topic, the log time, ns, and the content of each message, as rosbags decodes them."""
    found: dict[str, list] = {}
    with AnyReader([log]) as reader:
        for connection, log_time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((log_time_ns, message))
    return found


def vector(v):
    return np.array([v.x, v.y, v.z])


def test_own_odometry_is_what_the_vehicle_sent(bag):
    """The logged ENU odometry equals LOCAL_POSITION_NED of the same time, converted here independently."""
    sent = dict(bag["/cf1/mavlink/sys1/comp1/LOCAL_POSITION_NED"])
    compared = 0
    for time_ns, odometry in bag["/cf1/odom"]:
        if time_ns in sent:
            m, p = sent[time_ns], odometry.pose.pose.position
            assert (p.x, p.y, p.z) == pytest.approx((m.y, m.x, -m.z), abs=1e-6)
            speed = vector(odometry.twist.twist.linear)
            assert np.linalg.norm(speed) == pytest.approx(math.hypot(m.vx, m.vy, m.vz), abs=1e-6)
            compared += 1
    assert compared > 500


def test_every_raw_frame_is_also_decoded_and_names_its_peer(log, bag):
    raw = [m for topic in ("/uas1/mavlink_source", "/uas1/mavlink_sink") for _, m in bag[topic]]
    peers = LogFile(log).metadata()["cf1/mavlink_peers"]
    assert {m.header.frame_id for m in raw} == set(peers) == {"p00"}
    assert re.fullmatch(r"127\.0\.0\.1:\d+", peers["p00"])
    decoded = {topic: len(ms) for topic, ms in bag.items() if topic.startswith("/cf1/mavlink/")}
    assert sum(decoded.values()) == len(raw)
    parser, counts = mav.MAVLink(None), Counter()
    with AnyReader([log]) as reader:
        for _, _, data in reader.messages([c for c in reader.connections if c.topic.startswith("/uas1/")]):
            message = parser.decode(bytearray(unpack_mavlink(bytes(data)).frame))
            sender = f"sys{message.get_srcSystem()}/comp{message.get_srcComponent()}"
            counts[f"/cf1/mavlink/{sender}/{message.get_type()}"] += 1
    assert counts == decoded


def rerun(home, *arguments):
    """Run Rerun with its own home folder, because it stores settings there; return the ended process."""
    done = subprocess.run(
        [str(RERUN), *map(str, arguments)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        env=os.environ | {"HOME": str(home), "NO_COLOR": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done


def test_view_makes_a_recording_that_rerun_accepts(log, bag, tmp_path):
    out = tmp_path / "flight.rrd"
    done = flightstack("view", log, "--save", out)
    assert done.code == 0, done.err
    rerun(tmp_path, "rrd", "verify", out)
    reader = rrd_reader(out)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    rows, columns = entities(out)
    steps = bag["/cf1/controller/step"]
    for curve in ("barrier/h/estimate", "velocity/z/filtered", "age/age/target", "timing/wall/exec"):
        entity = f"/cf1/{curve}"
        assert rows[entity] == len(steps), entity
    for entity, column in (
        ("/world/cf1/target_pad/barrier", "Mesh3D:vertex_positions"),
        ("/world/cf1/target/pad", "Cylinders3D"),
        ("/world/cf1/vehicle", "Transform3D:translation"),
        ("/world/cf1/vehicle_path", "LineStrips3D:strips"),
        ("/world/cf1/velocity/command", "Arrows3D:vectors"),
        ("/cf1/phase", "StateChange:state"),
    ):
        assert any(c.startswith(column) for c in columns[entity]), (entity, columns[entity])
    assert rows["/events"] == len(bag["/rosout"])
    for chunk in reader.store().stream().to_chunks():
        if chunk.entity_path == "/cf1/barrier/h/estimate" and not chunk.is_static:
            shown = [v[0] for v in chunk.to_record_batch().column("Scalars:scalars").to_pylist()]
            np.testing.assert_array_equal(shown, [m.h_m for _, m in steps])
    again = flightstack("view", log, "--save", out)
    assert (again.code, "--force" in again.err) == (2, True)


def numeric(reader, topic, fields):
    """Whether this path of fields leads to a number in the message definitions of the log."""
    (connection,) = [c for c in reader.connections if c.topic == topic]
    kind = connection.msgtype
    for i, field in enumerate(fields):
        types = dict(reader.typestore.fielddefs[kind][1])
        assert field in types, (topic, field, list(types))
        node, argument = types[field]
        if node == Nodetype.BASE:
            return i == len(fields) - 1 and argument[0] != "string"
        assert node == Nodetype.NAME, (topic, field)
        kind = argument
    return False


def test_foxglove_layout_names_topics_and_fields_that_are_there(log):
    panels = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]
    with AnyReader([log]) as reader:
        topics = {c.topic for c in reader.connections}
        checked = 0
        for name, config in panels.items():
            for path in config.get("paths", []):
                topic, *fields = path["value"].split(".")
                assert numeric(reader, topic, fields), path["value"]
                checked += 1
            for key in ("topicToRender", "topicPath"):
                assert config.get(key, "/rosout") in topics, name
            assert set(config.get("topics", {})) <= topics
        assert checked > 25
        frames = {f"frame:{name}" for name in ("map_ned", "cf1/target_pad", "cf1/target", "cf1/base_link")}
        assert set(panels["3D!scene"]["transforms"]) <= frames


def test_plotjuggler_layout_names_topics_and_fields_that_are_there(log):
    curves = [c.get("name") for c in ElementTree.parse(LAYOUTS / "plotjuggler.xml").iter("curve")]
    assert len(curves) > 25
    with AnyReader([log]) as reader:
        topics = {c.topic for c in reader.connections}
        for curve in curves:
            (topic,) = [t for t in topics if curve.startswith(t + "/")]
            assert numeric(reader, topic, curve.removeprefix(topic + "/").split("/")), curve


def test_the_commands_of_the_page_run(log, tmp_path):
    page = (ROOT / "docs/how_to/viewing.md").read_text()
    lines = re.findall(r"^\.venv/bin/(flightstack view .*)$", page, re.MULTILINE)
    (tmp_path / "runs/first").mkdir(parents=True)
    (tmp_path / "runs/first/flight.mcap").symlink_to(log)
    files = [line for line in lines if "--save" in line]
    assert (len(lines), len(files)) == (3, 1)
    for line in files:
        done = flightstack(*line.split()[1:], cwd=tmp_path)
        assert done.code == 0, (line, done.err)
        assert (tmp_path / line.split()[-1]).exists()
    for frame in ("map", "map_ned", "cf1/base_link", "cf1/target", "cf1/target_pad"):
        assert f"| `{frame}` |" in page


def test_view_serves_a_browser_on_this_machine_only(log):
    process = subprocess.Popen(
        [*COMMAND, "view", str(log), "--web"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        said = []
        for line in lines_of(process.stdout, PATIENCE_S):  # the output ends if Rerun does not start
            said.append(line)
            if "Hosting a web-viewer at" in line:
                break
        address = re.search(r"Hosting a web-viewer at http://([\d.]+):\d+", "".join(said))
        assert address is not None, said
        assert address.group(1) == "127.0.0.1"
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE_S)
        killed(process)
