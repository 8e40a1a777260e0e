"""Pacing by a clock of the test's own."""

import pytest

from flightstack.common import pacing
from flightstack.common.pacing import EPOCH_NS, FastClock, LockstepClock, RealTimePacer


class Clock:
    def __init__(self):
        self.now = 100.0
        self.slept = []

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds

    def pacer(self, rate_hz):
        return RealTimePacer(
            rate_hz, monotonic=self.monotonic, sleep=self.sleep, unix_ns=lambda: 5_000_000_000
        )


def test_deadlines_are_absolute():
    clock = Clock()
    pacer = clock.pacer(100)
    for number in range(50):
        tick = pacer.wait()
        assert tick.number == number
        assert tick.now_s == pytest.approx(number * 0.01, abs=1e-9)
        assert tick.unix_ns == pytest.approx(5_000_000_000 + number * 10_000_000, abs=10)
        clock.now += 0.003 + 0.001 * (number % 3)  # work of varying length does not shift the next deadline
    assert pacer.overruns == 0


def test_missed_deadlines_are_counted_and_not_made_up_for():
    clock = Clock()
    pacer = clock.pacer(100)
    pacer.wait()
    clock.now += 0.0351
    late = pacer.wait()
    assert pacer.overruns == 2  # two more deadlines passed behind the one it was late for
    assert late.lateness_s == pytest.approx(0.0251, abs=1e-6)
    following = pacer.wait()
    assert following.now_s == pytest.approx(0.04, abs=1e-6)
    assert following.lateness_s == pytest.approx(0.0, abs=1e-9)


def test_a_clock_that_is_twice_as_fast_makes_twice_as_many_ticks_and_their_times_agree_between_processes(
    monkeypatch,
):
    wall, day_ns = Clock(), 86_400_000_000_000
    monkeypatch.setattr(pacing.time, "monotonic", wall.monotonic)
    monkeypatch.setattr(pacing.time, "sleep", wall.sleep)
    monkeypatch.setattr(pacing.time, "time_ns", lambda: 20_000 * day_ns + round(wall.now * 1e9))

    def pacer():
        clock = FastClock(2.0)
        return RealTimePacer(100, monotonic=clock.monotonic, sleep=clock.sleep, unix_ns=clock.unix_ns)

    first = pacer()
    ticks = [first.wait() for _ in range(101)]
    assert wall.now == pytest.approx(100.5, abs=1e-6)  # a second of stack time in half a second
    assert ticks[-1].now_s == pytest.approx(1.0, abs=1e-6)
    assert ticks[-1].period_s == pytest.approx(0.01, abs=1e-6)
    assert first.overruns == 0
    later = pacer()  # of another process, which starts now
    assert later.wait().unix_ns == pytest.approx(ticks[-1].unix_ns, abs=10_000)
    wall.now += 0.011  # two deadlines of 5 ms each behind the one it is late for
    assert later.wait().lateness_s == pytest.approx(0.012, abs=1e-6)
    assert later.overruns == 1
    assert FastClock().unix_ns() == pacing.time.time_ns()


def test_lockstep_time_is_the_simulators():
    clock = LockstepClock(100)
    tick = clock.tick(1_230_000_000)
    assert (tick.number, tick.now_s, tick.unix_ns) == (123, 1.23, EPOCH_NS + 1_230_000_000)


def test_ports_kept_for_a_run_are_not_given_to_another():
    from flightstack.common.processes import Port

    ports = [Port() for _ in range(20)]
    try:
        assert len({port.number for port in ports}) == 20
        assert all(port.number < 32_768 for port in ports)
    finally:
        for port in ports:
            port.close()
