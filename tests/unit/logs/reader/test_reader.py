"""Logs open unmodified elsewhere, and every broken one gives all it holds."""

from __future__ import annotations

import math
import random

import pytest
from rosbags.highlevel import AnyReader

from logs.reader.reader import LogError, LogFile, open_log
from logs.recorder.feed_wire import Kind, Record, encode_json
from logs.recorder.mcap_file import McapFile
from logs.recorder.recording import Recorder
from logs.schema import schemas
from logs.schema.codec_mavlink import pack_mavlink
from logs.schema.events import Severity, pack_log
from logs.schema.rows import ControllerStepRow, LoopTimingRow, TrueStateRow

EPOCH_NS = 1_577_836_800_000_000_000
ZERO = (0.0, 0.0, 0.0)
NAN = (math.nan, math.nan, math.nan)
FRAME = bytes([0xFD, 9, 0, 0, 1, 1, 1, 0, 0, 0, *range(9), 0xAB, 0xCD])

CHANNELS = {
    1: ("/cf1/controller/step", schemas.CONTROLLER_STEP),
    2: ("/cf1/loop/timing", schemas.LOOP_TIMING),
    3: ("/cf1/sim/truth", schemas.TRUE_STATE),
    4: ("/uas1/mavlink_source", schemas.MAVLINK),
    5: ("/rosout", schemas.LOG),
}


def payloads(tick, now_ns):
    p = (0.01 * tick, 0.0, 1.0)
    step = ControllerStepRow(
        now_ns, tick, 3, 2, 1, 0, True, False, True, True, 0.0, 0.0, p, ZERO, 0.0, ZERO, ZERO, 0.0,
        0.5, ZERO, 0.0, ZERO, ZERO, ZERO, 0.0, 0.0, 1, 1, 0, True, False, NAN, math.nan,
    )  # fmt: skip
    truth = TrueStateRow(
        now_ns, tick, p, ZERO, (0.0, 0.0, 0.0, 1.0), ZERO, (1.0, 2.0, 3.0, 4.0), ZERO, ZERO, 0.0,
        0.5, 0.4, math.inf, 3, NAN, NAN, math.nan, True, 3.8, ZERO,
    )  # fmt: skip
    yield 1, step.pack()
    yield 2, LoopTimingRow(now_ns, tick, 0.01, 0.0, 0.0, 0.0, 0, 0).pack()
    yield 3, truth.pack()
    yield 4, pack_mavlink(now_ns, FRAME)
    if tick % 100 == 0:
        yield 5, pack_log(now_ns, Severity.INFO, "onboard", f"tick {tick}")


def record(path, ticks=300, close=True):
    """Write a flight the way the recorder does, in small chunks; without ``close`` as if killed."""
    file = McapFile(path)
    recorder = Recorder(file)
    run = {"name": "run", "values": {"barrier_alpha_1_m": "1.0", "barrier_beta_m": "1.5", "seed": "1"}}
    recorder.handle(0, Record(Kind.METADATA, 0, 0, 0, 0, encode_json(Kind.METADATA, 0, 0, run)[28:]))
    recorder.handle(0, Record(Kind.ATTACHMENT, 0, 0, 0, 0, b'{"name": "s.toml", "media_type": "t"}\nx = 1'))
    for number, (topic, schema) in CHANNELS.items():
        declared = encode_json(Kind.DECLARE, number, 0, {"topic": topic, "schema": schema})[28:]
        recorder.handle(0, Record(Kind.DECLARE, number, 0, 0, 0, declared))
    for tick in range(ticks):
        now_ns = EPOCH_NS + tick * 10_000_000
        for number, payload in payloads(tick, now_ns):
            recorder.handle(0, Record(Kind.MESSAGE, number, now_ns, now_ns, tick, payload))
        if tick % 20 == 19:
            recorder.flush()
    if close:
        recorder.handle(0, Record(Kind.GOODBYE, 0, 0, 0, 0, b""))
        recorder.gone(0, 0)
        recorder.finish()
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("flight") / "flight.mcap")


def test_rosbags_opens_it_and_decodes_every_message(recorded):
    decoded: dict[str, int] = {}
    with AnyReader([recorded]) as reader:
        for connection, log_time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert log_time_ns >= EPOCH_NS
            decoded[connection.topic] = decoded.get(connection.topic, 0) + 1
            if connection.topic == "/cf1/sim/truth":
                assert math.isinf(message.h_min_outside_pad_m)
                assert list(message.rotor_rpm) == [1.0, 2.0, 3.0, 4.0]
        assert reader.message_count == sum(decoded.values())
    assert decoded == {
        "/cf1/controller/step": 300, "/cf1/loop/timing": 300, "/cf1/sim/truth": 300,
        "/uas1/mavlink_source": 300, "/rosout": 3, "/tf": 150, "/tf_static": 1, "/cf1/pose": 150,
        "/cf1/odom": 150, "/cf1/target/pose": 150, "/cf1/cmd/velocity_nominal": 150,
        "/cf1/cmd/velocity_filtered": 150, "/cf1/cbf/markers": 15, "/cf1/cmd/velocity": 150, "/cf1/run": 1,
        "/diagnostics": 2, "/uas1/mavlink/sys1/comp1/HEARTBEAT": 300,
    }  # fmt: skip


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
    assert sorted((m.topic, m.log_time_ns, m.data) for m in open_log(recorded)) == theirs
    (step,) = [m for m in log.messages({"/cf1/controller/step"}) if m.sequence == 7]
    assert step.publish_time_ns == EPOCH_NS + 70_000_000
    assert step.decode().own_position_enu_m.x == 0.07
    assert {m.topic for m in log.messages({"/tf", "/rosout"})} == {"/tf", "/rosout"}
    assert log.metadata()["run"]["seed"] == "1"
    assert [(a.name, a.data) for a in log.attachments()] == [("s.toml", b"x = 1")]


def test_cut_anywhere_it_gives_everything_before_the_cut(recorded, tmp_path):
    whole = list(open_log(recorded))
    data = recorded.read_bytes()
    cut_file = tmp_path / "cut.mcap"
    rng = random.Random(3)
    counts = []
    for cut in sorted([8, 9, len(data) - 1, *(rng.randrange(8, len(data)) for _ in range(40))]):
        cut_file.write_bytes(data[:cut])
        log = LogFile(cut_file)
        messages = list(log.messages())
        assert messages == whole[: len(messages)]
        assert not log.complete
        assert log.problem
        counts.append(len(messages))
        if cut > 2000:
            assert log.metadata()["run"]["seed"] == "1"
    assert counts == sorted(counts)  # a later cut never gives less
    assert counts[0] == 0
    assert counts[-1] == len(whole)
    assert len(set(counts)) > 10


def test_killed_before_the_end(tmp_path):
    path = record(tmp_path / "killed.mcap", ticks=250, close=False)
    steps = [m for m in open_log(path) if m.topic == "/cf1/controller/step"]
    assert len(steps) == 240  # the last flush
    assert not LogFile(path).complete


def test_one_flipped_byte_ends_the_reading_there(recorded, tmp_path):
    whole = list(open_log(recorded))
    data = bytearray(recorded.read_bytes())
    broken_file = tmp_path / "broken.mcap"
    rng = random.Random(4)
    incomplete = 0
    for _ in range(40):
        at = rng.randrange(8, len(data))
        data[at] ^= 0x10
        broken_file.write_bytes(data)
        data[at] ^= 0x10
        log = LogFile(broken_file)
        messages = list(log.messages())  # whatever breaks, no exception
        assert len(messages) <= len(whole)
        incomplete += not log.complete
    assert incomplete > 20  # chunks carry checksums; index records do not


@pytest.mark.parametrize(
    ("content", "expected"),
    [(b"", "is empty"), (b"hello, world", "not an MCAP file"), (b"\x89MCA", "not an MCAP file")],
)
def test_not_a_log(tmp_path, content, expected):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=expected):
        open_log(path)


def test_no_such_log(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        LogFile(tmp_path / "none.mcap")
