"""Helpers for tests of logs: a recorded flight, its messages, and a bounded wait for a process."""

from __future__ import annotations

import math

from flightstack.common.pacing import EPOCH_NS
from logs.recorder.feed import Attachment, Declare, Goodbye, Metadata, control, encode
from logs.recorder.recording import McapFile, Recorder
from logs.schema import schemas
from logs.schema.events import Severity, pack_log
from logs.schema.mavlink import pack_mavlink
from logs.schema.rows import LoopTimingRow, TrueStateRow
from tests.step_rows import step_row


def timing(tick):
    return LoopTimingRow(EPOCH_NS + tick, tick, 0.01, 0.0, 0.0, 0.0, 0, 0).pack()


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
    step = step_row(
        stamp_ns=now_ns, tick=tick, phase=3, request=2, filter_status=1, setpoint_sent=True, own_valid=True,
        target_valid=True, link_valid=True, own_position_enu_m=p, h_m=0.5, iterations=1, target_accepted=1,
        wanted_enu_m_s=NAN, command_yaw_rad=math.nan,
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
    """Write a log as the recorder does, in small chunks; without ``close`` the log ends as after a kill."""
    recorder = Recorder(McapFile(path))
    client = recorder.client()
    recorder.take(client, control(Metadata("run", {"seed": "1"})))
    recorder.take(client, control(Attachment("s.toml", "t", b"x = 1")))
    for number, (topic, schema) in CHANNELS.items():
        recorder.take(client, control(Declare(number, topic, schema)))
    for tick in range(ticks):
        now_ns = EPOCH_NS + tick * 10_000_000
        for number, payload in payloads(tick, now_ns):
            recorder.take(client, encode(number, now_ns, now_ns, tick, payload))
        if tick % 20 == 19:
            recorder.flush()
    if close:
        recorder.take(client, control(Goodbye()))
        recorder.gone(client)
        recorder.finish()
    return path
