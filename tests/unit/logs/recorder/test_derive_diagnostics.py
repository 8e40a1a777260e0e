"""Once a second the log says how loop, inputs, safety and link did; nothing missing is called good."""

from __future__ import annotations

import math

import pytest

from logs.derive.derive import Derivers
from logs.derive.diagnostics import Health
from logs.derive.frames import SENDERS_MAX, FrameCounter
from logs.schema import schemas
from logs.schema.codec_mavlink import pack_mavlink
from logs.schema.rows import LoopTimingRow
from tests.unit.logs.recorder.test_derive import step

EPOCH_NS = 1_577_836_800_000_000_000
STORE = schemas.typestore()
DT_NS = 10_000_000
OK, WARN, ERROR, STALE = 0, 1, 2, 3


def frame(sequence, system=1, peer=b"p00"):
    return pack_mavlink(1, bytes([0xFD, 1, 0, 0, sequence, system, 1, 0, 0, 0, 7, 1, 2]), peer)


def second(row=None, timing=None, frames=(), sent=0, ticks=100):
    """Diagnostics of one second: name without name space -> (level, message, values)."""
    health = Health("/cf1")
    for data in frames:
        health.incoming.add(data)
    for i in range(sent):
        health.outgoing.add(frame(i))
    made = []
    for tick in range(ticks + 1):
        t_ns = EPOCH_NS + tick * DT_NS
        if tick < ticks:
            health.step(row(tick) if row else step(tick * DT_NS, link_valid=True))
        timed = LoopTimingRow(t_ns, tick, 0.01, 1e-4, 1e-3, 2e-4, 0, 0)
        made += health.timing(t_ns, timing(tick, timed) if timing else timed)
    ((topic, schema, data),) = made
    assert (topic, schema) == ("/diagnostics", schemas.DIAGNOSTIC_ARRAY)
    array = STORE.deserialize_cdr(data, schema)
    assert bytes(STORE.serialize_cdr(array, schema)) == data
    assert array.header.stamp.sec == (EPOCH_NS + ticks * DT_NS) // 10**9
    assert all(s.hardware_id == "cf1" for s in array.status)
    return {
        s.name.removeprefix("cf1: "): (s.level, s.message, {v.key: v.value for v in s.values})
        for s in array.status
    }


def test_a_good_second():
    found = second(frames=[frame(i) for i in range(5)], sent=7)
    assert {name: level for name, (level, _, _) in found.items()} == {
        "loop": OK, "vehicle link": OK, "inputs": OK, "safety": OK,
    }  # fmt: skip
    assert found["loop"][2]["exec_max_s"] == "0.001"
    assert found["vehicle link"][2] == {"frames_in": "5", "frames_out": "7", "lost": "0", "lost_share": "0"}
    assert found["inputs"][2]["target_age_max_s"] == "0.02"
    assert found["safety"][2]["h_min_m"] == "0.4"


@pytest.mark.parametrize(
    ("name", "level", "changes"),
    [
        ("inputs", WARN, {50: {"own_valid": False}}),
        ("inputs", STALE, {99: {"target_valid": False}}),
        ("safety", WARN, {50: {"filter_status": 3}}),
        ("safety", WARN, {50: {"gate": 2}}),
        ("safety", ERROR, {50: {"h_m": -0.001}}),
        ("vehicle link", ERROR, {99: {"link_valid": False}}),
    ],
)
def test_what_one_tick_does(name, level, changes):
    good = {"link_valid": True}
    found = second(lambda tick: step(tick * DT_NS, **(good | changes.get(tick, {}))))
    assert found[name][0] == level
    assert all(other[0] == OK for key, other in found.items() if key != name)


@pytest.mark.parametrize(
    ("level", "change"),
    [(WARN, {"lateness_s": 0.003}), (WARN, {"overruns": 1}), (ERROR, {"feed_dropped": 4})],
)
def test_what_the_loop_does(level, change):
    found = second(timing=lambda tick, row: row._replace(**change) if tick >= 50 else row)
    assert found["loop"][0] == level


def test_an_age_never_known_is_not_small():
    values = second(lambda tick: step(tick * DT_NS, own_age_s=math.nan if tick == 3 else 0.0))["inputs"][2]
    assert values["own_age_max_s"] == "nan"


def test_lost_frames_by_sequence_numbers():
    counter = FrameCounter()
    for sequence in (250, 251, 254, 255, 0, 1, 5, 4):  # 2 lost, then 3 of which one comes late
        counter.add(frame(sequence))
        counter.add(frame(sequence, system=2, peer=b""))  # another sender does not mix in
    assert counter.take() == (16, 10)
    assert counter.take() == (0, 0)
    for system in range(SENDERS_MAX + 50):
        counter.add(frame(0, system=system % 256))
    assert len(counter._last) <= SENDERS_MAX


def test_lost_frames_warn():
    assert second(frames=[frame(i) for i in range(0, 20, 2)])["vehicle link"][0] == WARN
    assert second()["vehicle link"][2]["lost_share"] == "nan"  # nothing heard: no share of it


def test_steps_without_timings_do_not_pile_up():
    health = Health("/cf1")
    for tick in range(3000):
        health.step(step(tick * DT_NS))
    assert len(health._steps) == 1000


def test_a_recorder_counts_frames_for_the_name_space_of_the_run():
    derivers = Derivers()
    steps = derivers.declare("/cf1/controller/step", schemas.CONTROLLER_STEP)
    frames = derivers.declare("/uas1/mavlink_source", schemas.MAVLINK)
    derivers.metadata("onboard", {"namespace": "cf1"})
    timings = derivers.declare("/cf1/loop/timing", schemas.LOOP_TIMING)
    assert derivers.declare("/rosout", schemas.LOG) is None
    found = []
    for tick in range(101):
        t_ns = EPOCH_NS + tick * DT_NS
        frames(t_ns, frame(tick))
        steps(t_ns, step(tick * DT_NS).pack())
        found += timings(t_ns, LoopTimingRow(t_ns, tick, 0.01, 0.0, 0.0, 0.0, 0, 0).pack())
    (array,) = [STORE.deserialize_cdr(data, schema) for _, schema, data in found]
    values = {v.key: v.value for s in array.status if s.name == "cf1: vehicle link" for v in s.values}
    assert values["frames_in"] == "101"
