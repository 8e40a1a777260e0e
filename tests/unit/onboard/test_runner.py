"""The sequence of a tick; a flight never ends in the air without a landing request."""

import math
from types import SimpleNamespace

import pytest

from bridge.ros2.cdr import Odometry
from bridge.target.odometry import RawSample
from flightstack.common.pacing import Tick
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Inputs, Landed, Mode, Operator, Phase, VehicleStatus
from flightstack.onboard import lockstep
from flightstack.onboard.leaving import LAND_SHOWN_MAX_S, Leaving
from flightstack.onboard.lockstep import Patience
from flightstack.onboard.runner import (
    STALL_MAX_S,
    Arrived,
    ClockStoppedError,
    LiveTarget,
    Refusals,
    Runner,
    Taken,
    VehicleInputs,
    decoded,
)


def status(mode=Mode.EXTERNAL, *, armed=True):
    return VehicleStatus(0.0, armed, mode, Landed.IN_AIR, True)


def out(phase=Phase.APPROACH, *, finished=False):
    return SimpleNamespace(phase=phase, finished=finished)


def asking(operator=Operator.NONE, *, stop=False):
    return SimpleNamespace(operator=operator, stop=stop)


@pytest.mark.parametrize("seen", [None, status(armed=False)])
def test_what_does_not_fly_is_left_at_once(seen):
    person = asking(stop=True)
    flight = Leaving(3.0, person)
    assert flight.operator(seen, 1.0) is Operator.NONE
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 1.0) == (Phase.WAIT, "ended by the operator", 1)
    person.stop = False
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 3.0) == (Phase.WAIT, "3 s are over", 1)
    assert flight.ended(out(Phase.WAIT), Memory(), seen, 2.99) is None


def test_what_somebody_else_flies_is_left_to_them():
    person = asking(stop=True)
    flight, theirs = Leaving(3.0, person), Memory(abort_way=AbortWay.HANDS_OFF)
    flight.operator(status(), 1.0)
    assert flight.ended(out(), theirs, status(), 1.0).reason == "ended by the operator"
    person.stop = False
    assert flight.ended(out(), theirs, status(), 3.0).reason == "3 s are over"


def test_a_time_that_is_over_in_flight_is_an_abort():
    flight = Leaving(3.0)
    assert flight.operator(status(), 2.99) is Operator.NONE
    assert flight.operator(status(), 3.0) is Operator.TIME_OVER
    assert flight.ended(out(), Memory(phase=Phase.APPROACH), status(), 3.0) is None
    down = flight.ended(out(Phase.ABORT, finished=True), Memory(reason="abort"), status(armed=False), 9.0)
    assert down == (Phase.ABORT, "abort; 3 s are over", 1)
    in_time = flight.ended(out(Phase.LANDED, finished=True), Memory(reason="motors off"), status(), 2.0)
    assert in_time == (Phase.LANDED, "motors off", 0)


def test_lockstep_waits_for_others_no_longer_than_a_second(monkeypatch):
    now, person = SimpleNamespace(s=100.0), asking()
    monkeypatch.setattr(lockstep, "time", SimpleNamespace(monotonic=lambda: now.s))
    patience = Patience(person)
    assert not patience.over()
    person.stop, now.s = True, 200.0
    assert not patience.over()
    now.s += LAND_SHOWN_MAX_S - 1e-6
    assert not patience.over()
    now.s += 2e-6
    assert patience.over()


class Parts:
    """All parts of a runner, with its controller; records the calls. The landing starts at 0.02 s."""

    def __init__(self, ticks, ends_at_s=math.inf):
        self.calls, self.taken, self.ticks, self.ends_at_s = [], [], iter(range(ticks)), ends_at_s
        self.memory = Memory()
        self.runner = Runner(self, self, self, self, self, self)

    def wait(self):
        for number in self.ticks:
            self.calls.append("wait")
            return Tick(number, 0.01 * number, number, 0.0, 0.0)
        raise ClockStoppedError("no further message from the vehicle")

    def samples(self, now_s):
        self.calls.append("samples")
        return Arrived(("sample",))

    def read(self):
        self.calls.append("read")
        return VehicleInputs("own", "status", True)

    def operator(self, status, now_s):
        assert status == "status"
        return Operator.LAND

    def step(self, inputs, now_s, *, command_failed):
        self.calls.append("step")
        self.memory.started_s = min(self.memory.started_s, 0.02 if now_s >= 0.01 else math.inf)
        return SimpleNamespace(now_s=now_s)

    def answer(self, out, now_s):
        assert out.now_s == now_s
        self.calls.append("answer")

    def landing_began(self, tick):
        self.calls.append(("landing began", tick))

    def write(self, tick, taken, out, exec_s):
        assert exec_s >= 0.0
        self.calls.append("write")
        self.taken.append(taken)

    def ended(self, out, memory, status, now_s):
        return "over" if now_s >= self.ends_at_s else None


def test_the_vehicle_is_answered_before_anything_is_written_and_the_target_hears_once_of_the_landing():
    parts = Parts(4, ends_at_s=0.03)
    assert [parts.runner.tick() for _ in range(4)] == [None, None, None, "over"]
    tick = ["wait", "samples", "read", "step", "answer", "write"]
    began = [*tick[:-1], ("landing began", 2), "write"]
    assert parts.calls == [*tick, *tick, *began, *tick]
    assert parts.taken[0] == Taken(
        Inputs("own", "status", ("sample",), Operator.LAND), True, Arrived(("sample",))
    )


@pytest.mark.parametrize(("stall_s", "used"), [(STALL_MAX_S / 2, True), (2 * STALL_MAX_S, False)])
def test_samples_of_a_tick_in_which_the_process_stalled_are_told_and_not_used(stall_s, used):
    messages = [RawSample(Odometry(1, "map", "target", (1.0, 2.0, 0.2), (1.0, 0.0, 0.0, 0.0)).pack())]
    target = LiveTarget(SimpleNamespace(poll=lambda: messages), lambda: 8.0 + stall_s)
    arrived = target.samples(8.0)
    assert arrived.messages == messages
    if used:
        assert (arrived.samples[0].arrival_s, arrived.problems) == (8.0, [])
    else:
        assert arrived.samples == ()
        assert f"stalled for {stall_s:.2f} s" in arrived.problems[0]


def test_a_stream_of_refused_samples_is_told_by_doublings():
    refusals, told = Refusals(), []
    for n in range(1, 101):
        told += refusals.told([f"target sample refused: {n}", *(["stalled"] if n == 7 else [])])
    assert told == [
        "target sample refused: 1", "target sample refused: 2 (2 refused so far)",
        "target sample refused: 4 (4 refused so far)", "stalled",
        *(f"target sample refused: {n} ({n} refused so far)" for n in (8, 16, 32, 64)),
    ]  # fmt: skip


def test_a_sample_that_cannot_be_decoded_is_a_problem_and_stays_for_the_log():
    messages = [RawSample(b"")]
    arrived = decoded(messages, 1.0)
    assert (arrived.samples, arrived.messages) == ((), messages)
    assert "target sample refused: odometry payload has 0 bytes" in arrived.problems[0]
    assert decoded([], 1.0) == Arrived()
