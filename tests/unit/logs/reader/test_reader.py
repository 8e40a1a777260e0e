"""Tests that other programs read our logs, and that hostile texts and names in a log do no harm."""

from __future__ import annotations

import io
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rich.console import Console
from rich.table import Table
from rich.text import Text
from rosbags.highlevel import AnyReader

from flightstack.cli.main import main
from flightstack.common.terminal import Terminal
from flightstack.common.text import one_line, plain
from flightstack.onboard.recording import new_folder
from flightstack.watch import draw
from logs.reader.flight import load_flight
from logs.reader.reader import LogFile
from logs.recorder.recording import McapFile
from logs.report.report import write_report
from logs.schema import schemas
from logs.schema.events import Severity, pack_log
from logs.schema.rows import ControllerStepRow, HealthRow
from logs.verdict.verdict import judged
from tests.unit.logs.helpers import CHANNELS, EPOCH_NS, payloads, record


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
    assert ControllerStepRow.unpack(step.data).own_position_enu_m[0] == 0.07
    assert {m.topic for m in log.messages({"/tf", "/rosout"})} == {"/tf", "/rosout"}
    assert log.metadata()["run"]["seed"] == "1"
    assert [(a.name, a.data) for a in log.attachments()] == [("s.toml", b"x = 1")]


RERUN = Path(sys.executable).parent / "rerun"
PATIENCE_S = 120.0


def counts(log):
    found: dict[str, int] = {}
    for message in LogFile(log).messages():
        found[message.topic] = found.get(message.topic, 0) + 1
    assert len(found) >= 13
    return found


def same(a, b):
    """Whether two messages have equal fields; their classes may come from different decoders."""
    fields = getattr(b, "__dataclass_fields__", None)
    if fields is not None:
        return all(
            same(getattr(a, f), getattr(b, f)) for f in fields if "ClassVar" not in str(fields[f].type)
        )
    if isinstance(b, list | np.ndarray):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b or (a != a and b != b)


def test_two_cdr_libraries_agree_on_every_message(recorded):
    """The ROS 2 decoder of the MCAP project and rosbags decode every message to equal fields."""
    with recorded.open("rb") as stream, AnyReader([recorded]) as bags:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        theirs: dict[str, list] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            theirs.setdefault(channel.topic, []).append((message.log_time, decoded))
        other: dict[str, list] = {}
        for connection, log_time_ns, data in bags.messages():
            decoded = bags.deserialize(data, connection.msgtype)
            other.setdefault(connection.topic, []).append((log_time_ns, decoded))
    assert {topic: len(messages) for topic, messages in theirs.items()} == counts(recorded)
    for topic, messages in theirs.items():
        for (time_a, a), (time_b, b) in zip(messages, other[topic], strict=True):
            assert time_a == time_b
            assert same(a, b), topic


def rerun(tmp_path, *arguments):
    """Run Rerun with a temporary home folder, because it stores settings there."""
    return subprocess.run(
        [str(RERUN), *map(str, arguments)],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        env=os.environ | {"HOME": str(tmp_path), "NO_COLOR": "1"},
    )  # fmt: skip


def test_rerun_finds_nothing_wrong_and_converts_every_message(recorded, tmp_path):
    checked = rerun(tmp_path, "mcap", "check", recorded)
    assert checked.returncode == 0, checked.stderr
    lines = re.findall(r"^(\w+)\s+\d+\s+\d+\s+(/\S+)", checked.stdout, re.MULTILINE)
    states = {topic: state for state, topic in lines}
    expected = counts(recorded)
    assert states == dict.fromkeys(expected, "ok")
    converted = rerun(tmp_path, "mcap", "convert", recorded, "-o", tmp_path / "log.rrd")
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


EVIL = "[bold]x[/y] :smile: \x1b[31m\x07\x9b2J\r \u202e <b onload=1>&amp; %{y} | `rm` **"
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e]")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b[2Jb", r"a\x1b[2Jb"),
        ("a\rb\x00\x7f\x85", r"a\rb\x00\x7f\x85"),
        ("\u202ecba\u2066\u200f", r"\u202ecba\u2066\u200f"),
        ("\udcff.mcap", r"\udcff.mcap"),  # the path contains a byte that is not UTF-8
        ("a\u2028b\tc\nd", "a\\u2028b\tc\nd"),
        ("Größe ≤ 5 µm, 東京", "Größe ≤ 5 µm, 東京"),
        (Path("[test]/a"), "[test]/a"),
    ],
)
def test_control_characters_can_be_read(text, shown):
    assert plain(text) == shown
    assert one_line(text) == shown.replace("\n", "\\n").replace("\t", "\\t")


def test_a_terminal_shows_every_text_as_it_is_written(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    out = io.StringIO()
    console = Terminal()
    console.file = out
    table = Table("[red]head[/]", title=EVIL)
    table.add_row(EVIL, Text(EVIL))
    for each in (EVIL, Text(EVIL), table):
        console.print(each, soft_wrap=True)
    assert out.getvalue().count("[bold]x[/y] :smile: \\x1b[31m\\x9b2J") == 5
    assert "[red]head[/]" in out.getvalue()
    assert not CONTROLS.search(out.getvalue())


def evil_log(path, metadata):
    file = McapFile(path)
    for name, values in metadata.items():
        file.metadata(name, values)
    channels = {n: file.channel(*CHANNELS[n]) for n in CHANNELS}
    file.write(file.channel(f"/evil\x1b[31m{EVIL}", schemas.LOG), EPOCH_NS, 0, 0, b"")
    for tick in range(40):
        now_ns = EPOCH_NS + tick * 10_000_000
        for number, payload in payloads(tick, now_ns):
            file.write(channels[number], now_ns, now_ns, tick, payload)
    file.write(channels[5], now_ns, 0, 0, pack_log(now_ns, Severity.ERROR, "<i>", EVIL + "<script>alert(1)"))
    file.close()
    return path


def test_a_log_of_others_is_shown_and_not_obeyed(tmp_path):
    run = {"scenario": EVIL, "filter": "[/x]"}
    log = evil_log(tmp_path / "[red]a.mcap", {EVIL: {"k\n": EVIL}, "run": run})
    result = CliRunner().invoke(main, ["log", "verdict", str(log)])
    assert "[/x]" in result.output
    assert not CONTROLS.search(result.output)
    page = write_report(*judged(log), tmp_path / "page.html").read_text()
    for text in ("<script>alert", "<b onload", "<i>"):
        assert text not in page.replace("<i></i>", "")
    shown = load_flight(log)
    assert shown.events[-1].text.endswith("<script>alert(1)")  # the text is unchanged


@pytest.mark.parametrize("name", ["../../evil", "a/../b", "/a", "<b>", "a b", "x" * 65])
def test_names_of_a_log_become_no_paths(tmp_path, name):
    log = evil_log(tmp_path / "a.mcap", {"fleet": {"members": f"{name},cf2"}})
    for verb in (["report"], ["log", "verdict"]):
        result = CliRunner().invoke(main, [*verb, str(log)])
        assert result.exit_code == 2
        assert repr(name)[1:-1] in result.output


def test_the_view_of_a_fleet_takes_reasons_for_words(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    reason = "it said: log [/fs/microsd] full\nready tcp/1"
    health = HealthRow(1, 42, *[0.1] * 5, 1, 2, *[True] * 6, 100, 1, 2, 3, reason)
    watch = SimpleNamespace(step=None, fresh=True, timings=[], health=health, health_fresh=True)
    out = io.StringIO()
    Console(file=out).print(draw({"[cf1]": watch}, "[t]"))
    assert "log [/fs/microsd] full\\nready tcp/1" in out.getvalue()
    assert "[cf1]" in out.getvalue()
    assert "[t]" in out.getvalue()


@pytest.mark.parametrize(
    "name", ["../x", "a/b", "", "\0z", "\x1b[31m\n", "<b>", "%s{0}", "\u202e", ".", "x" * 300]
)
def test_the_name_of_a_scenario_becomes_no_path(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    made = new_folder(f"campaign-{name}-paper")
    assert list(Path("runs").iterdir()) == [made]
    assert re.fullmatch(r"\d{8}-\d{6}-campaign-[\w.-]{0,100}", made.name)
