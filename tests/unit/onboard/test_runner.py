"""The sequence of a tick; a flight never ends in the air without a landing request."""

import math
from types import SimpleNamespace

import pytest

from bridge.ros2.cdr import Odometry
from bridge.target.odometry import RawSample
from flightstack.common.pacing import Tick
from flightstack.core.memory import Memory
from flightstack.core.types import Inputs, Landed, Mode, Operator, Phase, VehicleStatus
from flightstack.onboard.runner import (
    STALL_MAX_S,
    Arrived,
    ClockStoppedError,
    LiveTarget,
    Runner,
    Taken,
    VehicleInputs,
    decoded,
)


def status(mode=Mode.EXTERNAL, *, armed=True):
    return VehicleStatus(0.0, armed, mode, Landed.IN_AIR, True)


def out(phase=Phase.APPROACH, *, finished=False):
    return SimpleNamespace(phase=phase, finished=finished)


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


def test_a_sample_that_cannot_be_decoded_is_a_problem_and_stays_for_the_log():
    messages = [RawSample(b"")]
    arrived = decoded(messages, 1.0)
    assert (arrived.samples, arrived.messages) == ((), messages)
    assert "target sample refused: odometry payload has 0 bytes" in arrived.problems[0]
    assert decoded([], 1.0) == Arrived()
