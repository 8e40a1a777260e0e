"""Tests the comparison of logs: equal flights have no difference, and each difference is reported."""

from __future__ import annotations

import pytest

from logs.compare import ABSENT, compare
from logs.reader.reader import LogError
from logs.recorder.recording import RECORDER_NAME, McapFile
from logs.schema import schemas
from logs.schema.events import pack_log
from logs.schema.rows import LoopTimingRow
from tests.step_rows import step_row

ZERO = (0.0, 0.0, 0.0)
STEP_TOPIC = "/cf1/controller/step"


def step(tick, **changes):
    given = {
        "stamp_ns": tick, "tick": tick, "phase": 3, "own_position_enu_m": (1.0, 2.0, 3.0),
        "h_m": float("nan"), "target_accepted": 1,
    }  # fmt: skip
    return step_row(**(given | changes)).pack()


def timing(tick, exec_s):
    return LoopTimingRow(tick, tick, 0.01, 0.0, exec_s, 0.0, 0, 0).pack()


def steps(*replaced):
    """Return ten steps; ``replaced``: messages that replace the steps with the same sequence numbers."""
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
    """Return a function that compares ten steps with other messages and returns the differences as text."""

    def run(messages, **options):
        a = write(tmp_path / "a.mcap", steps())
        b = write(tmp_path / "b.mcap", messages, **options)
        forward, backward = compare(a, b).differences, compare(b, a).differences
        assert len(forward) == len(backward)
        assert compare(b, b) == ([], None)
        return [str(difference) for difference in forward]

    return run


def replaced(number=4, log_ns=None, publish_ns=None, **changes):
    log_ns, publish_ns = (10 * number if t is None else t for t in (log_ns, publish_ns))
    return steps((STEP_TOPIC, schemas.CONTROLLER_STEP, log_ns, publish_ns, number, step(number, **changes)))


EVENT = ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 20, "onboard", "phase LAND"))


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        (steps(), []),
        (steps()[::-1], []),  # the order in the file does not matter
        (replaced(own_position_enu_m=(1.0, 2.5, 3.0)), [f"{STEP_TOPIC}[4] own_position_enu_m.y: 2.0 != 2.5"]),
        (replaced(slack_m_s=-0.0), [f"{STEP_TOPIC}[4] slack_m_s: 0.0 != -0.0"]),  # h_m is NaN in both
        (replaced(log_ns=41), [f"{STEP_TOPIC}[4] log_time_ns: 40 != 41"]),
        (replaced(publish_ns=39), [f"{STEP_TOPIC}[4] publish_time_ns: 40 != 39"]),
        ([*steps()[:9], (*steps()[9][:4], 12, steps()[9][5])], [f"{STEP_TOPIC}[9] sequence: 9 != 12"]),
        (steps()[:9], [f"{STEP_TOPIC} count: 10 != 9"]),
        ([*steps(), EVENT], ["/rosout count: 0 != 1"]),
    ],
)
def test_differences_are_named(differ, messages, expected):
    assert differ(messages) == expected


@pytest.mark.parametrize(
    ("messages", "tick"),
    [
        (steps(), None),
        (replaced(slack_m_s=-0.0), 4),
        (steps()[:9], 9),
        ([*steps(), (*EVENT[:2], 25, 25, *EVENT[4:])], 3),  # the event is between ticks 2 and 3
    ],
)
def test_the_first_tick_that_differs_is_named(tmp_path, messages, tick):
    a, b = write(tmp_path / "a.mcap", steps()), write(tmp_path / "b.mcap", messages)
    assert compare(a, b).first_tick == compare(b, a).first_tick == tick


def test_wall_clock_is_declared_and_left_out(differ):
    extra = [
        ("/cf1/loop/timing", schemas.LOOP_TIMING, 1, 1, 1, timing(1, 0.123)),
        ("/rosout", schemas.LOG, 1, 1, 1, pack_log(1, 30, RECORDER_NAME, "onboard dropped 3")),
    ]
    run = (("seed", "1"), ("started", "today"), ("realtime_factor", "33"))
    assert differ(steps() + extra, run=run) == []


def test_metadata_and_attachments(differ):
    found = differ(steps(), run=(("seed", "2"),), attachments=(("s.toml", b"y"), ("o.toml", b"")))
    assert [each.partition(" sha256")[0] for each in found] == [
        f"attachment o.toml content: {ABSENT!r} != 'application/toml, 0 bytes,",
        "attachment s.toml content: 'application/toml, 1 bytes,",
        "metadata run seed: '1' != '2'",
    ]


def test_a_log_that_shows_nothing_is_an_error(tmp_path):
    a = write(tmp_path / "a.mcap", steps())
    b = write(tmp_path / "b.mcap", [])
    with pytest.raises(LogError, match="no controller step"):
        compare(a, b)
    c = write(tmp_path / "c.mcap", steps(), close=False)
    with pytest.raises(LogError, match="not a whole log"):
        compare(a, c)
