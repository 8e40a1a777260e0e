"""Pacing by a clock of the test's own."""

import pytest

from flightstack.pacing import EPOCH_NS, LockstepClock, RealTimePacer


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


def test_lockstep_time_is_the_simulators():
    clock = LockstepClock(100)
    tick = clock.tick(1_230_000_000)
    assert (tick.number, tick.now_s, tick.unix_ns) == (123, 1.23, EPOCH_NS + 1_230_000_000)


def test_ports_kept_for_a_run_are_not_given_to_another():
    from flightstack.processes import Port

    ports = [Port() for _ in range(20)]
    try:
        assert len({port.number for port in ports}) == 20
        assert all(port.number < 32_768 for port in ports)
    finally:
        for port in ports:
            port.close()
