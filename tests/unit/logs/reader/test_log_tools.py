"""Tests ``log info``, ``log recover`` and ``log export`` on complete, damaged and foreign logs."""

from __future__ import annotations

import csv
import json

import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer

from flightstack.cli.main import main
from logs.compare import compare
from logs.reader.reader import LogFile
from logs.schema import schemas
from tests.unit.logs.helpers import record


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return a log of three seconds with one /rosout message a second and one /tf_static message."""
    return record(tmp_path_factory.mktemp("whole") / "whole.mcap")


@pytest.fixture(scope="module")
def broken(whole, tmp_path_factory):
    """Return a copy of the log ``whole``, truncated in the middle."""
    path = tmp_path_factory.mktemp("broken") / "broken.mcap"
    data = whole.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def log(*arguments):
    """Run ``flightstack log``; return exit status, standard output and standard error."""
    result = CliRunner().invoke(main, ["log", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout, result.stderr


def rows(path):
    return [(m.topic, m.log_time_ns, m.sequence, m.data) for m in LogFile(path).messages()]


def test_info_of_a_complete_log(whole):
    code, out, _ = log("info", whole)
    assert code == 0
    assert "complete" in out.splitlines()
    assert "seed = 1" in out
    code, out, _ = log("info", "--json", whole)
    found = json.loads(out)
    topics = {each["topic"]: each for each in found["topics"]}
    assert code == 0
    assert found["complete"]
    assert found["problem"] == ""
    assert found["size_bytes"] == whole.stat().st_size
    assert found["duration_s"] == pytest.approx(2.99)
    assert found["start"] == "2020-01-01T00:00:00+00:00"
    assert topics["/cf1/loop/timing"] == {
        "topic": "/cf1/loop/timing", "schema": schemas.LOOP_TIMING, "messages": 300,
        "rate_hz": pytest.approx(100.0),
    }  # fmt: skip
    assert topics["/tf_static"]["rate_hz"] is None
    assert found["messages"] == sum(each["messages"] for each in topics.values()) == len(rows(whole))
    assert found["metadata"]["run"]["seed"] == "1"
    assert found["attachments"] == [{"name": "s.toml", "bytes": 5}]


def test_a_broken_log_is_summarised_and_repaired(whole, broken, tmp_path):
    code, out, _ = log("info", "--json", broken)
    assert code == 1
    assert not json.loads(out)["complete"]
    assert f"of {broken.stat().st_size} can be read" in json.loads(out)["problem"]
    assert "BROKEN" in log("info", broken)[1]
    repaired = tmp_path / "repaired.mcap"
    code, out, _ = log("recover", broken, "--out", repaired)
    assert code == 0
    assert "can be read" in out
    assert LogFile(repaired).complete
    assert rows(repaired) == rows(broken)
    with repaired.open("rb") as stream:  # the new index is complete
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages()) == len(rows(broken))


def test_a_repaired_complete_log_is_equal_and_no_file_is_overwritten(whole, tmp_path):
    out = tmp_path / "again.mcap"
    assert log("recover", whole, "--out", out)[0] == 0
    assert rows(out) == rows(whole)
    assert compare(whole, out).differences == []
    assert log("diff", whole, out)[:2] == (0, "equal\n")
    code, _, err = log("recover", whole, "--out", out)
    assert code == 2
    assert "--force" in err
    assert log("recover", out, "--out", out, "--force")[0] == 0
    assert rows(out) == rows(whole)


def test_a_log_of_another_program_keeps_all_its_records(tmp_path):
    path, out = tmp_path / "foreign.mcap", tmp_path / "out.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "another program")
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
    assert log("recover", path, "--out", out)[0] == 0
    with out.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = reader.get_summary()
        assert [each.metadata["k"] for each in reader.iter_metadata()] == ["1", "2"]
    assert found.statistics.message_count == 20
    assert {each.topic: (each.message_encoding, each.metadata) for each in found.channels.values()} == {
        "/json": ("json", {"a": "b"}),
        "/bare": ("text", {}),
    }
    (index,) = found.attachment_indexes
    assert (index.create_time, index.log_time) == (7, 8)
    for topic in ("/json", "/bare"):
        code, _, err = log("export", path, "--topic", topic, "--format", "csv", "--out", tmp_path / "t.csv")
        assert code == 2
        assert "can be exported" in err
    assert "it contains /bare, /json" in log(
        "export", path, "--topic", "/x", "--format", "csv", "--out", tmp_path / "t.csv"
    )[2]  # fmt: skip
    assert not (tmp_path / "t.csv").exists()


def test_csv_and_parquet_contain_the_same_rows(whole, tmp_path):
    import pandas as pd  # late import: it takes 0.4 s in each worker

    tables = []
    for kind in ("csv", "parquet"):
        out = tmp_path / f"t.{kind}"
        code, said, _ = log("export", whole, "--topic", "/cf1/loop/timing", "--format", kind, "--out", out)
        assert code == 0
        assert said == f"{out}: 300 rows\n"
        tables.append(pd.read_csv(out) if kind == "csv" else pd.read_parquet(out))
    assert list(tables[0]) == list(tables[1])
    assert (tables[0] == tables[1]).all().all()
    assert list(tables[0]["sequence"]) == list(range(300))
    assert {"log_time_ns", "publish_time_ns", "header.stamp.sec"} <= set(tables[0])


@pytest.mark.parametrize(
    ("asked", "topics", "text"),
    [
        ("/a/step", ["/a/steps", "/b"], "did you mean /a/steps? it contains /a/steps, /b\n"),
        ("/zz", ["/b", "/a"], ".mcap; it contains /a, /b\n"),
        ("/zz", [f"/t{n:02}" for n in range(12)], "/t08, /t09 and 2 more (`log info`)\n"),
    ],
)
def test_a_wrong_topic_names_the_nearest_one_and_at_most_ten(tmp_path, asked, topics, text):
    path = tmp_path / "topics.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema("a/msg/A", "ros2msg", b"float64 x\n")
        for topic in topics:
            writer.register_channel(topic, "cdr", schema)
        writer.finish()
    code, _, err = log("export", path, "--topic", asked, "--format", "csv", "--out", tmp_path / "t.csv")
    assert code == 2
    assert err.endswith(text)


def test_lists_are_json_text_and_undecodable_messages_are_counted(tmp_path):
    path, out = tmp_path / "lists.mcap", tmp_path / "lists.csv"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema("a/msg/A", "ros2msg", b"float64[] values\nstring name\n")
        channel = writer.register_channel("/a", "cdr", schema)
        head, two = b"\x00\x01\x00\x00", (2).to_bytes(4, "little") + bytes(4)
        values = b"\x00\x00\x00\x00\x00\x00\xf8\x3f" + b"\x00\x00\x00\x00\x00\x00\xf0\x7f"
        text = (3).to_bytes(4, "little") + b"ok\x00"
        for i, data in enumerate((head + two + values + text, b"\x00\x01", head + two + values + text)):
            writer.add_message(channel, i, data, i, i)
        writer.finish()
    code, _, err = log("export", path, "--topic", "/a", "--format", "csv", "--out", out)
    assert code == 1
    assert "1 messages of /a cannot be decoded; first: " in err
    with out.open(newline="") as stream:
        found = list(csv.DictReader(stream))
    assert [(each["sequence"], json.loads(each["values"]), each["name"]) for each in found] == [
        ("0", [1.5, "inf"], "ok"),
        ("2", [1.5, "inf"], "ok"),
    ]
