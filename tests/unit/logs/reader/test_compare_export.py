"""Equal flights compare equal, any difference is named; an independent decoder reads the same exports."""

from __future__ import annotations

import csv
import math
from functools import reduce

import pyarrow.parquet
import pytest
from click.testing import CliRunner
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from bridge.ros2.codec import CDR_HEADER
from flightstack.cli.main import main
from logs.reader.reader import LogError
from logs.recorder.mcap_file import McapFile
from logs.recorder.recording import RECORDER_NAME
from logs.schema import schemas
from logs.schema.events import pack_log
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.tools.compare import ABSENT, compare
from tests.unit.logs.helpers import record

ZERO = (0.0, 0.0, 0.0)
STEP_TOPIC = "/cf1/controller/step"


def step(tick, **changes):
    row = ControllerStepRow(
        tick, tick, 3, 2, 1, 0, True, False, True, True, 0.0, 0.0, (1.0, 2.0, 3.0), ZERO, 0.0, ZERO, ZERO,
        0.0, float("nan"), ZERO, 0.0, ZERO, ZERO, ZERO, 0.0, 0.0, 1, 1, 0, True, False, ZERO, 0.0,
    )  # fmt: skip
    return row._replace(**changes).pack()


def timing(tick, exec_s):
    return LoopTimingRow(tick, tick, 0.01, 0.0, exec_s, 0.0, 0, 0).pack()


def steps(*replaced):
    """Return ten steps; each of ``replaced`` is (topic, schema, log time, publish time, sequence, data)."""
    rows = {i: (STEP_TOPIC, schemas.CONTROLLER_STEP, 10 * i, 10 * i, i, step(i)) for i in range(10)}
    rows.update({row[4]: row for row in replaced})
    return list(rows.values())


def write(path, messages, run=(("seed", "1"),), attachments=(("s.toml", b"x"),), close=True):
    file = McapFile(path)
    file.metadata("run", dict(run))
    for name, data in attachments:
        file.attachment(name, "application/toml", 0, data)
    for topic, schema, log_time_ns, publish_time_ns, sequence, data in messages:
        file.write(file.channel(topic, schema), log_time_ns, publish_time_ns, sequence, data)
    file.flush()
    if close:
        file.close()
    return path


@pytest.fixture
def differ(tmp_path):
    """Compare ten plain steps with other ones; return the differences as text."""

    def run(messages, **options):
        a = write(tmp_path / "a.mcap", steps())
        b = write(tmp_path / "b.mcap", messages, **options)
        forward, backward = compare(a, b), compare(b, a)
        assert len(forward) == len(backward)
        assert compare(b, b) == []
        return [str(difference) for difference in forward]

    return run


def replaced(number=4, log_ns=None, publish_ns=None, **changes):
    """Return ten steps, one of them changed."""
    log_ns, publish_ns = (10 * number if t is None else t for t in (log_ns, publish_ns))
    return steps((STEP_TOPIC, schemas.CONTROLLER_STEP, log_ns, publish_ns, number, step(number, **changes)))


EVENT = ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 20, "onboard", "phase LAND"))


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        (steps(), []),
        (steps()[::-1], []),  # the order in the file does not matter
        (
            replaced(own_position_enu_m=(1.0, 2.5, 3.0)),
            [f"{STEP_TOPIC}[4] own_position_enu_m.y: 2.0 != 2.5"],
        ),
        (replaced(slack_m_s=-0.0), [f"{STEP_TOPIC}[4] slack_m_s: 0.0 != -0.0"]),  # h_m is NaN in all
        (replaced(log_ns=41), [f"{STEP_TOPIC}[4] log_time_ns: 40 != 41"]),
        (replaced(publish_ns=39), [f"{STEP_TOPIC}[4] publish_time_ns: 40 != 39"]),
        ([*steps()[:9], (*steps()[9][:4], 12, steps()[9][5])], [f"{STEP_TOPIC}[9] sequence: 9 != 12"]),
        (steps()[:9], [f"{STEP_TOPIC} count: 10 != 9"]),
        ([*steps(), EVENT], ["/rosout count: 0 != 1"]),
    ],
)
def test_differences_are_named(differ, messages, expected):
    assert differ(messages) == expected


def test_wall_clock_is_declared_and_left_out(differ):
    extra = [
        ("/cf1/loop/timing", schemas.LOOP_TIMING, 1, 1, 1, timing(1, 0.123)),
        ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 30, RECORDER_NAME, "onboard dropped 3")),
    ]
    run = (("seed", "1"), ("started", "today"), ("realtime_factor", "33"))
    assert differ(steps() + extra, run=run) == []


def test_metadata_and_attachments(differ):
    found = differ(steps(), run=(("seed", "2"),), attachments=(("s.toml", b"y"), ("o.toml", b"")))
    assert found == [
        "metadata run seed: 1 != 2",
        f"attachment o.toml presence: {ABSENT} != present",
        "attachment s.toml content: application/toml 1 bytes != application/toml 1 bytes",
    ]


def test_a_log_that_shows_nothing_is_an_error(tmp_path):
    a = write(tmp_path / "a.mcap", steps())
    b = write(tmp_path / "b.mcap", [])
    with pytest.raises(LogError, match="no controller step"):
        compare(a, b)
    c = write(tmp_path / "c.mcap", steps(), close=False)
    with pytest.raises(LogError, match="not a whole log"):
        compare(a, c)


TICKS = 300


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return record(tmp_path_factory.mktemp("whole") / "whole.mcap", ticks=TICKS)


def export(log, out, *arguments, kind="csv"):
    result = CliRunner().invoke(
        main, ["log", "export", str(log), "--format", kind, "--out", str(out), *arguments]
    )
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def independent(log, topic):
    """Return messages decoded by the MCAP project's own ROS 2 decoder."""
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [(m.log_time, m.sequence, d) for _, _, m, d in reader.iter_decoded_messages(topics=[topic])]


def field(message, name):
    """Return the value at a path such as ``a.b[2]`` in a message."""
    steps = name.replace("[", ".").replace("]", "").split(".")
    return reduce(lambda m, s: m[int(s)] if s.isdigit() else getattr(m, s), steps, message)


def equal(text, value):
    if isinstance(value, float):
        return float(text) == value or (math.isnan(float(text)) and math.isnan(value))
    return text == str(value)


@pytest.mark.parametrize(
    "topic", ["/cf1/sim/truth", "/cf1/controller/step", "/cf1/pose", "/cf1/odom", "/rosout"]
)
def test_csv_is_what_another_decoder_sees(whole, tmp_path, topic):
    result = export(whole, tmp_path / "a.csv", "--topic", topic)
    assert result.exit_code == 0, result.output
    messages = independent(whole, topic)
    with (tmp_path / "a.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == len(messages) > 0
    assert f"{len(table)} rows" in result.stdout
    for row, (log_time_ns, sequence, message) in zip(table, messages, strict=True):
        assert int(row.pop("log_time_ns")) == log_time_ns
        assert int(row.pop("sequence")) == sequence
        row.pop("publish_time_ns")
        for name, text in row.items():
            assert equal(text, field(message, name)), name
    assert {"header.frame_id", "position_enu_m.x", "rotor_rpm[3]"} <= table[
        0
    ].keys() or topic != "/cf1/sim/truth"


def test_parquet_has_types_and_the_same_values(whole, tmp_path):
    result = export(whole, tmp_path / "a.parquet", "--topic", "/cf1/sim/truth", kind="parquet")
    assert result.exit_code == 0, result.output
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    assert table.num_rows == TICKS
    kinds = {f.name: str(f.type) for f in table.schema}
    assert kinds["log_time_ns"] == "uint64"
    assert kinds["position_enu_m.x"] == "double"
    assert kinds["motors_running"] == "bool"
    assert kinds["header.frame_id"] == "string"
    columns = table.to_pydict()
    for i, (log_time_ns, _, message) in enumerate(independent(whole, "/cf1/sim/truth")):
        assert columns["log_time_ns"][i] == log_time_ns
        assert columns["position_enu_m.x"][i] == message.position_enu_m.x
        assert columns["h_min_outside_pad_m"][i] == math.inf
        assert columns["motors_running"][i] is True


@pytest.mark.parametrize("topic", ["/rosout", "/cf1/cbf/markers", "/uas1/mavlink_source", "/tf_static"])
def test_parquet_takes_every_kind_of_topic(whole, tmp_path, topic):
    assert export(whole, tmp_path / "a.parquet", "--topic", topic, kind="parquet").exit_code == 0
    assert pyarrow.parquet.read_table(tmp_path / "a.parquet").num_rows == len(independent(whole, topic)) > 0


def test_a_broken_log_is_exported_up_to_its_break(whole, tmp_path):
    data = whole.read_bytes()
    (tmp_path / "broken.mcap").write_bytes(data[: len(data) // 2])
    result = export(tmp_path / "broken.mcap", tmp_path / "a.csv", "--topic", "/cf1/loop/timing")
    assert result.exit_code == 1
    assert "what can be read was used" in result.stderr
    assert 50 < len((tmp_path / "a.csv").read_text().splitlines()) < TICKS


def test_wrong_input(whole, tmp_path):
    for arguments, kind, word in (
        ([], "csv", "--topic"),
        (["--topic", "/nowhere"], "csv", "/cf1/loop/timing"),
    ):
        result = export(whole, tmp_path / "x", *arguments, kind=kind)
        assert result.exit_code == 2
        assert word in result.stderr
    foreign = tmp_path / "foreign.mcap"
    with foreign.open("wb") as stream:
        writer = Writer(stream)
        writer.start("")
        channel = writer.register_channel("/json", "json", writer.register_schema("T", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    result = export(foreign, tmp_path / "x", "--topic", "/json")
    assert result.exit_code == 2
    assert "json/jsonschema" in result.stderr
    assert not (tmp_path / "x").exists()


def test_a_type_of_somebody_else_is_read_by_the_definition_in_the_log(tmp_path):
    path = tmp_path / "other.mcap"
    definition = b"float32[2] pair\nOther inner\n" + b"=" * 80 + b"\nMSG: other_msgs/Other\nint16 value\n"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("other_msgs/msg/Thing", "ros2msg", definition)
        channel = writer.register_channel("/thing", "cdr", schema)
        writer.add_message(channel, 5, CDR_HEADER + bytes.fromhex("0000003f 000080be fdff"), 6, 7)
        writer.finish()
    assert export(path, tmp_path / "a.csv", "--topic", "/thing").exit_code == 0
    assert (tmp_path / "a.csv").read_text() == (
        "log_time_ns,publish_time_ns,sequence,pair[0],pair[1],inner.value\n5,6,7,0.5,-0.25,-3\n"
    )
