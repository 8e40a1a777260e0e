"""Logs, recovered and cut ones too, open unmodified elsewhere; every broken one gives all it holds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from logs.reader.reader import LogFile
from logs.schema import schemas
from logs.tools.recover import recover
from tests.unit.logs.helpers import EPOCH_NS, record


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("flight") / "flight.mcap")


def test_definitions_in_the_file_carry_constants_and_hashes(recorded):
    with AnyReader([recorded]) as reader:
        for connection in reader.connections:
            assert schemas.type_hash(connection.msgtype) == reader.typestore.hash_rihs01(connection.msgtype)
        step = reader.typestore.types[schemas.CONTROLLER_STEP]
        assert (step.PHASE_ABORT, step.FILTER_INFEASIBLE, step.GATE_APPROVED) == (8, 3, 0)


def test_our_reader_reads_the_same(recorded):
    log = LogFile(recorded)
    assert log.complete
    with AnyReader([recorded]) as reader:
        theirs = sorted((c.topic, t, bytes(d)) for c, t, d in reader.messages())
    assert sorted((m.topic, m.log_time_ns, m.data) for m in log.messages()) == theirs
    (step,) = [m for m in log.messages({"/cf1/controller/step"}) if m.sequence == 7]
    assert step.publish_time_ns == EPOCH_NS + 70_000_000
    assert step.decode().own_position_enu_m.x == 0.07
    assert {m.topic for m in log.messages({"/tf", "/rosout"})} == {"/tf", "/rosout"}
    assert log.metadata()["run"]["seed"] == "1"
    assert [(a.name, a.data) for a in log.attachments()] == [("s.toml", b"x = 1")]


RERUN = Path(sys.executable).parent / "rerun"
PATIENCE_S = 120.0


@pytest.fixture(scope="module", params=["recorded", "recovered"])
def log(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    whole = record(folder / "whole.mcap")
    if request.param == "recorded":
        return whole
    out = folder / f"{request.param}.mcap"
    killed = record(folder / "killed.mcap", close=False)
    data = killed.read_bytes()
    killed.write_bytes(data[:-100])
    recover(LogFile(killed), out)
    return out


def counts(log):
    found: dict[str, int] = {}
    for message in LogFile(log).messages():
        found[message.topic] = found.get(message.topic, 0) + 1
    assert len(found) >= 13
    return found


def same(a, b):
    """Field by field, whatever the classes of two decoders."""
    fields = getattr(b, "__dataclass_fields__", None)
    if fields is not None:
        return all(
            same(getattr(a, f), getattr(b, f)) for f in fields if "ClassVar" not in str(fields[f].type)
        )
    if isinstance(b, list | np.ndarray):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b or (a != a and b != b)


def test_two_cdr_libraries_agree_on_every_message(log):
    """The indexed reader and ROS 2 decoder of the MCAP project, and rosbags."""
    with log.open("rb") as stream, AnyReader([log]) as bags:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        theirs: dict[str, list] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            theirs.setdefault(channel.topic, []).append((message.log_time, decoded))
        other: dict[str, list] = {}
        for connection, log_time_ns, data in bags.messages():
            decoded = bags.deserialize(data, connection.msgtype)
            other.setdefault(connection.topic, []).append((log_time_ns, decoded))
    assert {topic: len(messages) for topic, messages in theirs.items()} == counts(log)
    for topic, messages in theirs.items():
        for (time_a, a), (time_b, b) in zip(messages, other[topic], strict=True):
            assert time_a == time_b
            assert same(a, b), topic


def rerun(tmp_path, *arguments):
    """Run the program with a home of its own: it keeps settings there."""
    return subprocess.run(
        [str(RERUN), *map(str, arguments)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        env=os.environ | {"HOME": str(tmp_path), "NO_COLOR": "1"},
    )  # fmt: skip


def test_rerun_finds_nothing_wrong_and_converts_every_message(log, tmp_path):
    checked = rerun(tmp_path, "mcap", "check", log)
    assert checked.returncode == 0, checked.stderr
    lines = re.findall(r"^(\w+)\s+\d+\s+\d+\s+(/\S+)", checked.stdout, re.MULTILINE)
    states = {topic: state for state, topic in lines}
    expected = counts(log)
    assert states == dict.fromkeys(expected, "ok")
    converted = rerun(tmp_path, "mcap", "convert", log, "-o", tmp_path / "log.rrd")
    assert converted.returncode == 0, converted.stderr
    verified = rerun(tmp_path, "rrd", "verify", tmp_path / "log.rrd")
    assert verified.returncode == 0, verified.stderr
    printed = rerun(tmp_path, "rrd", "print", tmp_path / "log.rrd")
    rows: dict[str, int] = {}
    for number, entity, columns in re.findall(
        r"with (\d+) rows .*? - (/\S+) - .*?data columns: \[(.*)\]", printed.stdout
    ):
        if "Odometry" in columns or "Step" in columns:
            rows[entity] = rows.get(entity, 0) + int(number)
    assert rows == {t: expected[t] for t in ("/cf1/odom", "/cf1/controller/step")}
