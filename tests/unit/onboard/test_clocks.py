"""Tests the pacing of the loop with a test clock, and ports, niceness and memory of processes."""

import sys
import threading
import time
from types import SimpleNamespace

import pytest

from flightstack.common import pacing, processes
from flightstack.common.pacing import (
    FastClock,
    FollowedClock,
    Follower,
    RealTimePacer,
    SimulationClock,
    chosen_clock,
)
from flightstack.common.processes import Child, LaunchError
from flightstack.compiled import jit
from flightstack.onboard import lockstep
from flightstack.onboard.runner import ClockStoppedError
from tests.processes.bounded import PATIENCE_S, wait_for


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
        return RealTimePacer(rate_hz, self)

    def unix_ns(self):
        return 5_000_000_000


def test_deadlines_are_absolute():
    clock = Clock()
    pacer = clock.pacer(100)
    for number in range(50):
        tick = pacer.wait()
        assert tick.number == number
        assert tick.now_s == pytest.approx(number * 0.01, abs=1e-9)
        assert tick.unix_ns == pytest.approx(5_000_000_000 + number * 10_000_000, abs=10)
        clock.now += 0.003 + 0.001 * (number % 3)  # the work varies, but the next deadline does not shift
    assert pacer.overruns == 0


def test_missed_deadlines_are_counted_and_not_made_up_for():
    clock = Clock()
    pacer = clock.pacer(100)
    pacer.wait()
    clock.now += 0.0351
    late = pacer.wait()
    assert pacer.overruns == 2  # after the missed deadline, two more deadlines have passed
    assert late.lateness_s == pytest.approx(0.0251, abs=1e-6)
    following = pacer.wait()
    assert following.now_s == pytest.approx(0.04, abs=1e-6)
    assert following.lateness_s == pytest.approx(0.0, abs=1e-9)


STEP_NS = 4_000_000
RATE_HZ = 100


def never():
    return False


def run(clock, steps, first=1):
    for step in range(first, first + steps):
        clock.advance(step * STEP_NS, never)


@pytest.fixture
def file(tmp_path):
    return tmp_path / "clock"


def test_a_follower_makes_every_tick_however_fast_the_simulator_is(file):
    clock = SimulationClock(file)
    followed = FollowedClock(file, Follower.ONBOARD)
    pacer = RealTimePacer(RATE_HZ, followed)
    ticks = []
    follower = threading.Thread(target=lambda: ticks.extend(pacer.wait() for _ in range(101)))
    follower.start()
    run(clock, 250)  # 250 steps are one second of simulated time
    follower.join(PATIENCE_S)
    assert not follower.is_alive()
    assert pacer.overruns == 0
    assert [tick.now_s for tick in ticks] == pytest.approx([k / RATE_HZ for k in range(101)], abs=0.0041)
    assert ticks[-1].unix_ns - ticks[0].unix_ns == pytest.approx(1e9, abs=4.1e6)


def test_the_simulator_stops_where_a_follower_waits(file, monkeypatch):
    monkeypatch.setattr(pacing, "_FOLLOWER_MAX_S", 60.0)
    clock, followed = SimulationClock(file), FollowedClock(file, Follower.TARGET)
    followed._cells[followed._place] = 2 * STEP_NS  # the follower waits for this step
    simulator = threading.Thread(target=run, args=(clock, 10))
    simulator.start()
    wait_for(lambda: clock.unix_ns() - followed._cells[0] == 2 * STEP_NS)
    simulator.join(0.2)
    assert simulator.is_alive()
    assert clock.unix_ns() - followed._cells[0] == 2 * STEP_NS
    followed._cells[followed._place] = 20 * STEP_NS  # the follower has processed every step that was due
    simulator.join(PATIENCE_S)
    assert not simulator.is_alive()
    assert clock.unix_ns() - followed._cells[0] == 10 * STEP_NS


def test_a_follower_that_was_killed_is_not_waited_for_again(file, monkeypatch):
    monkeypatch.setattr(pacing, "_FOLLOWER_MAX_S", 0.01)
    clock = SimulationClock(file)
    followed = FollowedClock(file, Follower.ONBOARD)
    run(clock, 1)
    followed._cells[followed._place] = STEP_NS  # the follower waits until this step and never continues
    run(clock, 1000)
    assert clock.unix_ns() - followed._cells[0] == 1000 * STEP_NS


def test_time_goes_on_for_the_followers_of_a_simulator_that_was_killed(file, monkeypatch):
    monkeypatch.setattr(pacing, "_STALL_MAX_S", 0.01)
    clock, followed = SimulationClock(file), FollowedClock(file, Follower.ONBOARD)
    clock.advance(STEP_NS, never)
    before_s = followed.monotonic()
    followed.sleep(0.05)  # the wait ends, although the simulator makes no step
    after_s = followed.monotonic()
    assert after_s >= before_s + 0.05
    clock.advance(2 * STEP_NS, never)  # the simulator was only slow; time never goes back
    assert followed.monotonic() >= after_s


@pytest.mark.parametrize(
    ("speed", "clocked", "lockstep"), [(2.0, True, False), (2.0, False, True), (1.0, True, True)]
)
def test_options_that_exclude_each_other_are_refused(file, speed, clocked, lockstep):
    SimulationClock(file)
    with pytest.raises(ValueError, match="exclude each other"):
        chosen_clock(speed, file if clocked else None, Follower.ONBOARD, lockstep=lockstep)


def test_a_file_that_is_no_clock_is_refused(file):
    file.write_bytes(b"no clock")
    with pytest.raises(ValueError, match="is not a simulator's clock: it has 8 bytes"):
        FollowedClock(file, Follower.ONBOARD)
    with pytest.raises(FileNotFoundError):
        FollowedClock(file.with_name("missing"), Follower.ONBOARD)


def child(tmp_path, code):
    return Child("slow", ["-c", code], tmp_path, program=[sys.executable])


def test_a_child_that_hangs_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "START_MAX_S", 0.4)
    with pytest.raises(LaunchError, match=r"slow did not start: not ready within 0\.4 s"):
        child(tmp_path, "import time; time.sleep(60)").wait_ready()


def test_one_that_ends_says_why(tmp_path):
    with pytest.raises(LaunchError, match="slow did not start: no such thing"):
        child(tmp_path, "raise SystemExit('no such thing')").wait_ready()


def test_a_long_wait_says_what_it_waits_for_once(monkeypatch, capsys):
    monkeypatch.setattr(pacing, "_SAID_S", 0.01)
    assert not pacing.wait_until(lambda: False, lambda: False, 0.2, pause_s=0.001, what="the robot")
    assert capsys.readouterr().err == "waits for the robot\n"


def test_compilation_is_announced_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(jit, "is_off", lambda: False)
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path)
    for _ in range(2):
        with jit.compiling("all", "adds"):
            pass
    assert capsys.readouterr().err.splitlines() == ["flightstack: compiling adds", "flightstack: compiled"]
    assert (jit.is_kept("all"), jit.is_kept("more")) == (True, False)


def test_a_clock_that_is_twice_as_fast_makes_twice_as_many_ticks_and_their_times_agree_between_processes(
    monkeypatch,
):
    wall, day_ns = Clock(), 86_400_000_000_000
    monkeypatch.setattr(pacing.time, "monotonic", wall.monotonic)
    monkeypatch.setattr(pacing.time, "sleep", wall.sleep)
    monkeypatch.setattr(pacing.time, "time_ns", lambda: 20_000 * day_ns + round(wall.now * 1e9))

    def pacer():
        return RealTimePacer(100, FastClock(2.0))

    first = pacer()
    ticks = [first.wait() for _ in range(101)]
    assert wall.now == pytest.approx(100.5, abs=1e-6)  # a second of stack time lasts half a second
    assert ticks[-1].now_s == pytest.approx(1.0, abs=1e-6)
    assert ticks[-1].period_s == pytest.approx(0.01, abs=1e-6)
    assert first.overruns == 0
    later = pacer()  # the pacer of another process that starts now
    assert later.wait().unix_ns == pytest.approx(ticks[-1].unix_ns, abs=10_000)
    wall.now += 0.011  # 11 ms of wall time: the deadlines at 5 and 10 ms have passed
    assert later.wait().lateness_s == pytest.approx(0.012, abs=1e-6)
    assert later.overruns == 1
    assert FastClock().unix_ns() == pacing.time.time_ns()


@pytest.mark.parametrize("asked_before", [False, True])
def test_a_companion_says_that_it_waits_for_its_vehicle_and_not_for_ever(monkeypatch, capsys, asked_before):
    monkeypatch.setattr(pacing, "_SAID_S", -1.0)
    for name in ("FIRST_WAIT_MAX_S", "WORLD_SILENT_S"):
        monkeypatch.setattr(lockstep, name, 0.1)
    endpoint = SimpleNamespace(wait=lambda _: time.sleep(0.001))
    link = SimpleNamespace(poll=lambda _: None, take_timesync=lambda: None, endpoint=endpoint)
    ticks = lockstep.VehicleTicks(link, 100, lambda: False)
    if asked_before:
        ticks.passed(0)
    why = "no further message" if asked_before else "no vehicle requested a tick within 0.1 s"
    with pytest.raises(ClockStoppedError, match=why):
        ticks.wait()
    assert capsys.readouterr().err.count("waits for the vehicle") == (not asked_before)
