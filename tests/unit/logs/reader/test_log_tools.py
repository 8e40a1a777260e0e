"""Tests the subcommand ``info`` on complete and on damaged logs."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from logs.info import gather
from logs.reader.reader import LogFile
from logs.recorder.recording import McapFile
from logs.schema import schemas
from logs.schema.rows import LoopTimingRow
from tests.unit.logs.helpers import EPOCH_NS, record


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return a log of three seconds with one /rosout message a second and one /tf_static message."""
    return record(tmp_path_factory.mktemp("whole") / "whole.mcap")


@pytest.fixture(scope="module")
def broken(whole, tmp_path_factory):
    """Return the log of ``whole``, truncated in the middle."""
    path = tmp_path_factory.mktemp("broken") / "broken.mcap"
    data = whole.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def info(*arguments):
    """Run ``flightstack log info``; return exit status and output."""
    result = CliRunner().invoke(main, ["log", "info", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout


def rows(path):
    return [(m.topic, m.log_time_ns, m.sequence, m.data) for m in LogFile(path).messages()]


def test_info_of_a_whole_log(whole):
    code, out = info(whole)
    assert code == 0
    assert "complete" in out.splitlines()
    assert "seed = 1" in out
    code, out = info("--json", whole)
    found = json.loads(out)
    topics = {t["topic"]: t for t in found["topics"]}
    assert code == 0
    assert found["complete"]
    assert found["problem"] == ""
    assert found["readable_bytes"] == found["size_bytes"] == whole.stat().st_size
    assert found["duration_s"] == pytest.approx(2.99)
    assert found["start"] == "2020-01-01T00:00:00Z"
    assert found["profile"] == "ros2"
    assert topics["/cf1/loop/timing"] == {
        "topic": "/cf1/loop/timing", "schema": schemas.LOOP_TIMING, "messages": 300,
        "rate_hz": pytest.approx(100.0),
    }  # fmt: skip
    assert topics["/tf_static"]["rate_hz"] is None
    assert found["messages"] == sum(t["messages"] for t in topics.values()) == len(rows(whole))
    assert found["metadata"]["run"]["seed"] == "1"
    assert found["attachments"] == [{"name": "s.toml", "media_type": "t", "bytes": 5}]


def test_info_of_a_broken_log_says_where_it_breaks(whole, broken):
    code, out = info("--json", broken)
    found = json.loads(out)
    assert code == 1
    assert not found["complete"]
    assert 0 < found["readable_bytes"] < found["size_bytes"] == broken.stat().st_size
    assert f"nothing after byte {found['readable_bytes']} of {found['size_bytes']}" in found["problem"]
    data = broken.read_bytes()
    readable = broken.parent / "readable.mcap"
    readable.write_bytes(data[: found["readable_bytes"]])
    assert rows(readable) == rows(broken)  # these bytes contain all readable messages
    code, out = info(broken)
    assert code == 1
    assert "BROKEN" in out


@pytest.mark.slow  # test_damage.py is quick
def test_every_byte_offset_of_a_small_log(tmp_path):
    """After a power failure the file may end at any byte."""
    small, cut = (tmp_path / name for name in ("small.mcap", "cut.mcap"))
    file = McapFile(small)
    channel = file.channel("/t", schemas.LOOP_TIMING)
    file.metadata("run", {"seed": "1"})
    ends = {}  # size of the file -> required messages
    for tick in range(6):
        file.write(channel, EPOCH_NS + tick, 5, tick, TIMING._replace(tick=tick).pack())
        if tick % 2:
            file.flush()
            ends[small.stat().st_size] = tick + 1
    file.attachment("s.toml", "t", 3, b"x = 1")
    file.close()
    data, all_rows = small.read_bytes(), rows(small)
    assert 1500 < len(data) < 8000
    counts = set()
    for at in range(8, len(data)):
        cut.write_bytes(data[:at])
        log = LogFile(cut)
        told = gather(log)
        messages = rows(cut)
        assert not told["complete"]
        assert told["problem"]
        assert told["readable_bytes"] <= at
        assert told["messages"] == len(messages)
        assert messages == all_rows[: len(messages)]
        assert len(messages) >= max((n for end, n in ends.items() if end <= at), default=0)
        counts.add(len(messages))
    assert counts == {0, 2, 4, 6}


TIMING = LoopTimingRow(EPOCH_NS, 0, 0.01, 0.0, 0.0, 0.0, 0, 0)
