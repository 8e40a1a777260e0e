"""Tests the order of the calls in a tick, and samples that a tick does not use."""

import math
from types import SimpleNamespace

import pytest

from bridge.ros2.cdr import Odometry
from bridge.target.odometry import RawSample
from flightstack.common.pacing import Tick
from flightstack.core.memory import Memory
from flightstack.core.types import Inputs, Operator
from flightstack.onboard import leaving
from flightstack.onboard.leaving import Person
from flightstack.onboard.runner import (
    STALL_MAX_S,
    Arrived,
    LiveWires,
    Refusals,
    Runner,
    Taken,
    VehicleInputs,
    decoded,
)

ANSWERS = {
    "samples": Arrived(("sample",)),
    "read": VehicleInputs("own", "status", True),
    "operator": Operator.LAND,
    "statuses": (),
}


class Parts:
    """Stands in for controller and links of a runner, and records the calls; the landing starts at 0.02 s."""

    def __init__(self):
        self.calls, self.memory = [], Memory()
        self.runner = Runner(*[self] * 3, self.write)

    def __getattr__(self, name):
        return lambda *given: self.calls.append((name, *given)) or ANSWERS.get(name)

    def wait(self):
        number = sum(call[0] == "samples" for call in self.calls)
        return Tick(number, 0.01 * number, number, 0.0, 0.0)

    def step(self, inputs, now_s, *, command_failed):
        self.calls.append(("step", inputs, command_failed))
        self.memory.started_s = 0.02 if now_s >= 0.01 else math.inf
        return SimpleNamespace(now_s=now_s)

    def ended(self, out, memory, status, now_s):
        return "over" if now_s >= 0.03 else None


def test_the_vehicle_is_answered_before_anything_is_written_and_the_target_hears_once_of_the_landing():
    parts = Parts()
    assert [parts.runner.tick() for _ in range(4)] == [None, None, None, "over"]
    tick = ["samples", "read", "operator", "statuses", "step", "answer", "write"]
    assert [name for name, *_ in parts.calls] == [*tick, *tick, *tick[:-1], "landing_began", "write", *tick]
    calls = {name: given for name, *given in parts.calls}
    assert calls["landing_began"] == [2]
    inputs = Inputs("own", "status", ("sample",), Operator.LAND)
    assert (calls["step"], calls["operator"][0]) == ([inputs, True], "status")
    assert calls["answer"][0].now_s == calls["answer"][1] == 0.03
    assert calls["write"][1] == Taken(inputs, True, Arrived(("sample",)))
    assert calls["write"][3] >= 0.0


@pytest.mark.parametrize(("stall_s", "used"), [(STALL_MAX_S / 2, True), (2 * STALL_MAX_S, False)])
def test_samples_of_a_tick_in_which_the_process_stalled_are_told_and_not_used(stall_s, used):
    messages = [RawSample(Odometry(1, "map", "target", (1.0, 2.0, 0.2), (1.0, 0.0, 0.0, 0.0)).pack())]
    pacer, source = SimpleNamespace(now_s=lambda: 8.0 + stall_s), SimpleNamespace(poll=lambda: messages)
    arrived = LiveWires(None, pacer, source, tuple).samples(8.0)
    assert arrived.messages == messages
    if used:
        assert (arrived.samples[0].arrival_s, arrived.problems) == (8.0, [])
    else:
        assert arrived.samples == ()
        assert f"stalled for {stall_s:.2f} s" in arrived.problems[0]


def test_a_sample_that_cannot_be_decoded_is_a_problem_and_stays_for_the_log():
    messages = [RawSample(b"")]
    arrived = decoded(messages, 1.0)
    assert (arrived.samples, arrived.messages) == ((), messages)
    assert "target sample refused: payload of 0 bytes" in arrived.problems[0]
    assert decoded([], 1.0) == Arrived()


def test_a_stream_of_refused_samples_is_told_by_doublings():
    refusals, told = Refusals(), []
    for n in range(1, 101):
        told += refusals.told([f"target sample refused: {n}", *(["stalled"] if n == 7 else [])])
    assert told == [
        "target sample refused: 1", "target sample refused: 2 (2 refused so far)",
        "target sample refused: 4 (4 refused so far)", "stalled",
        *(f"target sample refused: {n} ({n} refused so far)" for n in (8, 16, 32, 64)),
    ]  # fmt: skip


def test_a_process_that_ends_waits_for_ticks_no_longer_than_for_the_landing(monkeypatch):
    now, person = SimpleNamespace(s=100.0), Person()
    monkeypatch.setattr(leaving, "time", SimpleNamespace(monotonic=lambda: now.s))
    assert not person.left()
    person.stop = True
    for now.s, left in ((200.0, False), (200.0 + leaving.LAND_SHOWN_MAX_S - 1e-6, False), (201.1, True)):
        assert person.left() is left
