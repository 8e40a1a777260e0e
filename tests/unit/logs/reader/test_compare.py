"""Equal flights compare equal; any difference is found and named."""

from __future__ import annotations

import pytest

from logs.reader.reader import LogError
from logs.recorder.mcap_file import McapFile
from logs.recorder.recording import LOSSES, RECORDER_NAME
from logs.schema import schemas
from logs.schema.codec_mavlink import pack_mavlink
from logs.schema.events import pack_log
from logs.schema.rows import ControllerStepRow, LoopTimingRow
from logs.tools.compare import ABSENT, compare

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
    """Ten steps; each of ``replaced`` is (topic, schema, log time, publish time, sequence, data)."""
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
    """Compare ten plain steps with something else; returns the differences as text."""

    def run(messages, **options):
        a = write(tmp_path / "a.mcap", steps())
        b = write(tmp_path / "b.mcap", messages, **options)
        forward, backward = compare(a, b), compare(b, a)
        assert len(forward) == len(backward)
        assert compare(b, b) == []
        return [str(difference) for difference in forward]

    return run


def test_equal(differ):
    assert differ(steps()) == []


def test_order_in_the_file_says_nothing(differ):
    assert differ(steps()[::-1]) == []


def test_wall_clock_is_declared_and_left_out(differ):
    extra = [
        ("/cf1/loop/timing", schemas.LOOP_TIMING, 1, 1, 1, timing(1, 0.123)),
        ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 30, RECORDER_NAME, "onboard dropped 3")),
    ]
    run = (("seed", "1"), ("started", "today"), ("realtime_factor", "33"))
    assert differ(steps() + extra, run=run) == []


def test_one_value_is_named(differ):
    changed = (STEP_TOPIC, schemas.CONTROLLER_STEP, 40, 40, 4, step(4, own_position_enu_m=(1.0, 2.5, 3.0)))
    assert differ(steps(changed)) == [f"{STEP_TOPIC}[4] own_position_enu_m.y: 2.0 != 2.5"]


def test_signs_of_zero_differ_and_nan_equals_itself(differ):
    changed = (STEP_TOPIC, schemas.CONTROLLER_STEP, 40, 40, 4, step(4, slack_m_s=-0.0))
    assert differ(steps(changed)) == [f"{STEP_TOPIC}[4] slack_m_s: 0.0 != -0.0"]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ((STEP_TOPIC, schemas.CONTROLLER_STEP, 41, 40, 4, step(4)), "log_time_ns: 40 != 41"),
        ((STEP_TOPIC, schemas.CONTROLLER_STEP, 40, 39, 4, step(4)), "publish_time_ns: 40 != 39"),
    ],
)
def test_times(differ, row, expected):
    assert differ(steps(row)) == [f"{STEP_TOPIC}[4] {expected}"]


def test_sequence(differ):
    messages = steps()
    messages[9] = (*messages[9][:4], 12, messages[9][5])
    assert differ(messages) == [f"{STEP_TOPIC}[9] sequence: 9 != 12"]


def test_missing_message(differ):
    assert differ(steps()[:9]) == [f"{STEP_TOPIC} count: 10 != 9"]


def test_missing_topic(differ):
    extra = ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 20, "onboard", "phase LAND"))
    assert differ([*steps(), extra]) == ["/rosout count: 0 != 1"]


def test_arrays_of_other_length(tmp_path):
    logs = []
    for name, length in (("a", 8), ("b", 16)):
        frame = pack_mavlink(1, bytes([0xFD, length]) + bytes(8 + length) + b"ab")
        message = ("/uas1/mavlink_sink", schemas.MAVLINK, 1, 1, 1, frame)
        logs.append(write(tmp_path / name, [*steps(), message]))
    assert [str(d) for d in compare(*logs)] == [
        "/uas1/mavlink_sink[0] len: 8 != 16",
        "/uas1/mavlink_sink[0] payload64.length: 1 != 2",
        f"/uas1/mavlink_sink[0] payload64[1]: {ABSENT} != 0",
    ]


def test_metadata_and_attachments(differ):
    found = differ(steps(), run=(("seed", "2"),), attachments=(("s.toml", b"y"), ("o.toml", b"")))
    assert found == [
        "metadata run seed: 1 != 2",
        f"attachment o.toml presence: {ABSENT} != present",
        "attachment s.toml content: application/toml 1 bytes != application/toml 1 bytes",
    ]


def test_losses_are_wall_clock(tmp_path):
    a, b = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for path, losses in ((a, "0"), (b, "4")):
        file = McapFile(path)
        file.metadata(LOSSES, {"onboard": losses})
        file.write(file.channel(STEP_TOPIC, schemas.CONTROLLER_STEP), 0, 0, 0, step(0))
        file.close()
    assert compare(a, b) == []


def test_differences_are_bounded(tmp_path):
    a = write(tmp_path / "a.mcap", steps())
    b = write(tmp_path / "b.mcap", [(*m[:2], m[2] + 1, *m[3:]) for m in steps()])
    assert len(compare(a, b)) == 10
    assert len(compare(a, b, limit=3)) == 3


def test_a_log_that_shows_nothing_is_an_error(tmp_path):
    a = write(tmp_path / "a.mcap", steps())
    b = write(tmp_path / "b.mcap", [])
    with pytest.raises(LogError, match="no controller step"):
        compare(a, b)
    c = write(tmp_path / "c.mcap", steps(), close=False)
    with pytest.raises(LogError, match="not a whole log"):
        compare(a, c)
