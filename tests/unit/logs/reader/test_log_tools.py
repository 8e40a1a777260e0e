"""The verbs info and recover, on complete logs and on broken ones."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer

from flightstack.cli.main import main
from logs.reader.reader import LogFile
from logs.recorder.mcap_file import McapFile
from logs.schema import schemas
from logs.schema.rows import LoopTimingRow
from logs.tools.compare import compare
from logs.tools.info import gather
from tests.unit.logs.helpers import EPOCH_NS, record


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return three seconds; /rosout once a second, /tf_static once."""
    return record(tmp_path_factory.mktemp("whole") / "whole.mcap")


@pytest.fixture(scope="module")
def broken(whole, tmp_path_factory):
    """Return the same log, truncated in the middle."""
    path = tmp_path_factory.mktemp("broken") / "broken.mcap"
    data = whole.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


@pytest.fixture
def tool(tmp_path):
    """Run ``flightstack log ...``; return exit status, output and error text."""

    def run(*arguments):
        result = CliRunner().invoke(main, ["log", *map(str, arguments)])
        assert not isinstance(result.exception, Exception) or isinstance(result.exception, SystemExit)
        assert [p for p in tmp_path.iterdir() if p.name.startswith(".")] == []  # no temporary file remains
        return result.exit_code, result.stdout, result.stderr

    return run


def summary(path):
    """Return every message by the index, and the statistics, from the package's indexed reader."""
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = reader.get_summary()
        messages = [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
        names = [a.name for a in reader.iter_attachments()], [m.name for m in reader.iter_metadata()]
    assert found.statistics.message_count == len(messages)
    assert sum(found.statistics.channel_message_counts.values()) == len(messages)
    assert found.statistics.chunk_count == len(found.chunk_indexes)
    if messages:
        times = [m[1] for m in messages]
        assert (found.statistics.message_start_time, found.statistics.message_end_time) == (
            min(times),
            max(times),
        )
    return found, messages, names


def rows(path):
    return [(m.topic, m.log_time_ns, m.sequence, m.data) for m in LogFile(path).messages()]


def test_info_of_a_whole_log(tool, whole):
    code, out, _ = tool("info", whole)
    assert code == 0
    assert "complete" in out.splitlines()
    assert "seed = 1" in out
    code, out, _ = tool("info", "--json", whole)
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
        "topic": "/cf1/loop/timing", "schema": schemas.LOOP_TIMING, "encoding": "cdr", "messages": 300,
        "rate_hz": pytest.approx(100.0),
    }  # fmt: skip
    assert topics["/tf_static"]["rate_hz"] is None
    assert found["messages"] == sum(t["messages"] for t in topics.values()) == len(rows(whole))
    assert found["metadata"]["run"]["seed"] == "1"
    assert found["attachments"] == [{"name": "s.toml", "media_type": "t", "bytes": 5}]


def test_info_of_a_broken_log_says_where_it_breaks(tool, whole, broken):
    code, out, _ = tool("info", "--json", broken)
    found = json.loads(out)
    assert code == 1
    assert not found["complete"]
    assert 0 < found["readable_bytes"] < found["size_bytes"] == broken.stat().st_size
    assert f"nothing after byte {found['readable_bytes']} of {found['size_bytes']}" in found["problem"]
    data = broken.read_bytes()
    readable = broken.parent / "readable.mcap"
    readable.write_bytes(data[: found["readable_bytes"]])
    assert rows(readable) == rows(broken)  # nothing is lost
    code, out, _ = tool("info", broken)
    assert code == 1
    assert "BROKEN" in out


def test_recover_of_a_whole_log_is_the_same_log(tool, whole, tmp_path):
    out = tmp_path / "again.mcap"
    assert tool("recover", whole, "--out", out)[0] == 0
    assert rows(out) == rows(whole)
    assert compare(whole, out) == []
    code, said, _ = tool("diff", whole, out)
    assert (code, said) == (0, "equal\n")


def test_every_byte_offset_of_a_small_log(tmp_path):
    """After a power failure the file may end at any byte."""
    small, cut, out = (tmp_path / name for name in ("small.mcap", "cut.mcap", "out.mcap"))
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
        info = gather(log)
        messages = rows(cut)
        assert not info.complete
        assert info.problem
        assert info.readable_bytes <= at
        assert info.messages == len(messages)
        assert messages == all_rows[: len(messages)]
        assert len(messages) >= max((n for end, n in ends.items() if end <= at), default=0)
        counts.add(len(messages))
        if at % 37 == 0:  # the slow part: recover, and open with the package's indexed reader
            code = CliRunner().invoke(main, ["log", "recover", str(cut), "--out", str(out), "--force"])
            assert code.exit_code == 0, code.output
            assert summary(out)[1] == messages
            assert LogFile(out).complete
    assert counts == {0, 2, 4, 6}


TIMING = LoopTimingRow(EPOCH_NS, 0, 0.01, 0.0, 0.0, 0.0, 0, 0)


def test_files_that_exist_are_not_written_over_unless_forced(tool, whole, tmp_path):
    out = tmp_path / "mine.mcap"
    out.write_bytes(b"mine")
    code, _, err = tool("recover", whole, "--out", out)
    assert code == 2
    assert "--force" in err
    assert out.read_bytes() == b"mine"
    assert tool("recover", whole, "--out", out, "--force")[0] == 0
    assert LogFile(out).complete
    size = out.stat().st_size
    assert tool("recover", out, "--out", out, "--force")[0] == 0  # in place, by a temporary name
    assert out.stat().st_size >= size


def test_logs_of_other_programs_keep_what_we_do_not_know(tool, tmp_path):
    """Schemaless, JSON, repeated metadata names, a creation time: all are preserved."""
    path, out = tmp_path / "foreign.mcap", tmp_path / "out.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "somebody else")
        schema = writer.register_schema("Thing", "jsonschema", b"{}")
        one = writer.register_channel("/json", "json", schema, {"a": "b"})
        two = writer.register_channel("/bare", "text", 0)
        for i in range(10):
            writer.add_message(one, i, b'{"x": 1}', i, i)
            writer.add_message(two, i, b"hello", i, i)
        for value in ("1", "2"):
            writer.add_metadata("same", {"k": value})
        writer.add_attachment(7, 8, "a", "b", b"c")
        writer.finish()
    assert tool("recover", path, "--out", out)[0] == 0
    found, messages, names = summary(out)
    assert len(messages) == 20
    assert names[1] == ["same", "same", "log_tool"]
    assert {c.topic: (c.message_encoding, c.metadata) for c in found.channels.values()} == {
        "/json": ("json", {"a": "b"}),
        "/bare": ("text", {}),
    }
    (index,) = found.attachment_indexes
    assert (index.create_time, index.log_time) == (7, 8)
