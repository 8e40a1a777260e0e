"""The simulator's clock: nobody falls behind it, and nobody who has stopped holds up the others."""

import threading

import pytest

from flightstack.common import simulation_clock
from flightstack.common.pacing import FastClock, RealTimePacer
from flightstack.common.simulation_clock import FollowedClock, Follower, SimulationClock, chosen_clock

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
    pacer = RealTimePacer(
        RATE_HZ, monotonic=followed.monotonic, sleep=followed.sleep, unix_ns=followed.unix_ns
    )
    ticks = []
    follower = threading.Thread(target=lambda: ticks.extend(pacer.wait() for _ in range(101)))
    follower.start()
    run(clock, 250)  # one second
    follower.join(5.0)
    assert not follower.is_alive()
    assert pacer.overruns == 0
    assert [tick.now_s for tick in ticks] == pytest.approx([k / RATE_HZ for k in range(101)], abs=0.0041)
    assert ticks[-1].unix_ns - ticks[0].unix_ns == pytest.approx(1e9, abs=4.1e6)


def test_the_simulator_stops_where_a_follower_waits(file, monkeypatch):
    monkeypatch.setattr(simulation_clock, "_FOLLOWER_MAX_S", 60.0)
    clock, followed = SimulationClock(file), FollowedClock(file, Follower.TARGET)
    followed._cells[followed._place] = 2 * STEP_NS  # until when the follower waits
    simulator = threading.Thread(target=run, args=(clock, 10))
    simulator.start()
    simulator.join(0.2)
    assert simulator.is_alive()
    assert clock.unix_ns() - followed._cells[0] == 2 * STEP_NS
    followed._cells[followed._place] = 20 * STEP_NS  # it has done what was due
    simulator.join(5.0)
    assert not simulator.is_alive()
    assert clock.unix_ns() - followed._cells[0] == 10 * STEP_NS


def test_a_follower_that_was_killed_is_not_waited_for_again(file, monkeypatch):
    monkeypatch.setattr(simulation_clock, "_FOLLOWER_MAX_S", 0.01)
    clock = SimulationClock(file)
    followed = FollowedClock(file, Follower.ONBOARD)
    run(clock, 1)
    followed._cells[followed._place] = STEP_NS  # waits until now, and is never heard of again
    run(clock, 1000)
    assert clock.unix_ns() - followed._cells[0] == 1000 * STEP_NS


def test_time_goes_on_for_the_followers_of_a_simulator_that_was_killed(file, monkeypatch):
    monkeypatch.setattr(simulation_clock, "_STALL_MAX_S", 0.01)
    clock, followed = SimulationClock(file), FollowedClock(file, Follower.ONBOARD)
    clock.advance(STEP_NS, never)
    before_s = followed.monotonic()
    followed.sleep(0.05)  # ends, though nobody steps
    after_s = followed.monotonic()
    assert after_s >= before_s + 0.05
    clock.advance(2 * STEP_NS, never)  # it was only slow: time never goes back
    assert followed.monotonic() >= after_s


def test_a_process_that_is_to_end_does_not_wait_for_the_simulator(file):
    SimulationClock(file)
    FollowedClock(file, Follower.ONBOARD, stopped=lambda: True).sleep(0.05)


def test_the_clock_is_chosen_by_the_options(file):
    SimulationClock(file)
    assert isinstance(chosen_clock(1.0, file, Follower.TARGET), FollowedClock)
    assert chosen_clock(2.0, None, Follower.TARGET) == FastClock(2.0)


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
