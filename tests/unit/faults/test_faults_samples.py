"""Faults of sample streams: output, order and bounds of every kind, for vehicle state and target."""

import itertools
import math
from dataclasses import replace

import pytest

from sim.clock import TickGrid
from sim.faults.samples import HELD_MAX, EstimateFaults, SampleFaults, Shape
from sim.faults.schedule import Schedule
from sim.plant.sensors import NEVER_NS, NS
from sim.plant.vehicle_types import Estimate
from sim.robot.target import TargetMeasurement
from sim.robot.target_motion import TargetFaults, TargetMotion
from sim.scenarios.fault_spec import TABLE, After, Kind, What
from sim.scenarios.scenario import load
from tests.unit.faults.fault_helpers import fault, running

MS = NS // 1000
SHAPE = Shape(lambda s, o, turn: (s[0], s[1] + o[0], s[2] + turn), lambda first, now: (now[0], *first[1:]))


def flow(*faults, seconds=5.0, end_s=None):
    """Return (arrived_ms, (sent_ms, x, yaw)) at 100 Hz with faults from 1 s on; x is the time in s."""
    stage = SampleFaults(SHAPE)
    out = []
    for ms in range(0, round(seconds * 1000), 10):
        if ms == 1000:
            for one in faults:
                stage.begin(one)
        if end_s is not None and ms == round(end_s * 1000):
            for one in faults:
                stage.end(one, ms * MS)
        out += [(ms, sample) for sample in stage.deliver(ms * MS, [(ms, ms / 1000, 0.0)])]
        assert stage.release_ns == NEVER_NS or stage.release_ns > ms * MS
    return out


def mocap(kind, **values):
    return running(What.MOCAP, kind, 1.0, **values)


def after_start(out):
    return [(ms, s) for ms, s in out if ms >= 1000]


@pytest.mark.parametrize("kind", TABLE[What.MOCAP])
def test_before_and_after_a_fault_samples_are_as_they_were(kind):
    out = flow(mocap(kind), end_s=3.0)
    assert [(ms, s[0], s[1]) for ms, s in out if ms < 1000] == [
        (ms, ms, ms / 1000) for ms in range(0, 1000, 10)
    ]
    late = [(ms, s) for ms, s in out if ms > 3000]
    assert late == [(ms, (ms, ms / 1000, 0.0)) for ms in range(3010, 5000, 10)]


def test_off_lets_nothing_pass():
    assert after_start(flow(mocap(Kind.OFF))) == []


def test_stuck_repeats_the_first_sample_with_fresh_stamps():
    out = after_start(flow(mocap(Kind.STUCK)))
    assert len(out) == 400
    assert {s[1] for _, s in out} == {1.0}
    assert [s[0] for _, s in out] == [ms for ms, _ in out]


def test_wrong_shifts_and_turns():
    out = after_start(flow(mocap(Kind.WRONG, offset_m=(0.5, 0.0, 0.0), yaw_rad=0.2)))
    assert all(s == (ms, ms / 1000 + 0.5, 0.2) for ms, s in out)


def test_slow_lets_each_nth_pass():
    out = after_start(flow(mocap(Kind.SLOW, value=4)))
    assert {b - a for (a, _), (b, _) in itertools.pairwise(out)} == {40}


def test_delayed_keeps_order_and_lets_go_at_the_end():
    out = flow(mocap(Kind.DELAYED, value=0.5), end_s=3.0)
    assert {ms - s[0] for ms, s in out if 1500 <= ms < 3000} == {500}
    assert not [ms for ms, _ in out if 1000 <= ms < 1500]
    assert len([s for ms, s in out if ms == 3000]) == 51  # the delayed samples, and the current one
    assert [s[0] for _, s in out] == sorted(s[0] for _, s in out)
    assert len(out) == 500


def test_intermittent_pauses_and_comes_back():
    out = after_start(flow(mocap(Kind.INTERMITTENT, value=0.3, period_s=1.0)))
    assert {(ms - 1000) % 1000 for ms, _ in out} == set(range(300, 1000, 10))


def test_garbage_is_uniform_and_repeatable():
    out = after_start(flow(mocap(Kind.GARBAGE, value=2.0), seconds=41.0))
    errors = [s[1] - ms / 1000 for ms, s in out]
    assert max(map(abs, errors)) <= 2.0
    assert sum(e * e for e in errors) / len(errors) == pytest.approx(4.0 / 3.0, rel=0.1)
    assert out == after_start(flow(mocap(Kind.GARBAGE, value=2.0), seconds=41.0))


def test_drift_grows_with_time():
    out = after_start(flow(mocap(Kind.DRIFT, value=0.5)))
    errors = [s[1] - ms / 1000 for ms, s in out]
    assert errors[0] == 0.0
    assert abs(errors[-1]) <= 0.5 * 4.0
    assert errors[-1] == pytest.approx(2.0 * errors[199], rel=0.01)


def test_faults_act_one_after_the_other():
    shift = mocap(Kind.WRONG, offset_m=(1.0, 0.0, 0.0))
    out = after_start(flow(shift, mocap(Kind.DELAYED, value=0.1)))
    assert all(s[1] == pytest.approx((ms - 100) / 1000 + 1.0) for ms, s in out)


def test_what_is_held_is_bounded():
    stage = SampleFaults(SHAPE)
    stage.begin(running(What.MOCAP, Kind.DELAYED, value=5.0))
    stage.deliver(0, [(k, 0.0, 0.0) for k in range(HELD_MAX + 10)])
    assert len(stage.deliver(6 * NS, [])) == HELD_MAX


def test_own_state_goes_stale_and_comes_back():
    good = Estimate((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True)
    moved = Estimate((9.0, 2.0, 3.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), True)
    own, one = EstimateFaults(), running(What.OWN_STATE, Kind.OFF)
    assert own.report(0, moved) is moved
    own.begin(one)
    own.sample(0, good)
    assert own.report(499 * MS, moved) == good
    assert not own.report(500 * MS, moved).valid
    own.end(one, 600 * MS)
    assert own.due_ns == NEVER_NS
    assert own.report(600 * MS, moved) is moved


def target(time_s: float) -> TargetMeasurement:
    return TargetMeasurement(time_s, (time_s, 0.0, 0.2), 3.0, (0.1, 0.0, 0.0), 0.0)


def test_faults_of_the_target_wait_for_the_landing_and_are_told():
    spec = fault(What.TARGET_ODOMETRY, Kind.STUCK, start_s=0.5, duration_s=1.0, after=After.LANDING)
    faults = TargetFaults([spec, fault(What.MOTOR, Kind.DEAD)], 1)
    seen = []
    for ms in range(0, 4000, 10):
        if ms >= 1000:
            faults.landing_began(1000 * MS)  # repeated calls
        seen += faults.deliver(ms * MS, [target(ms / 1000)])
    assert [str(t) for t in faults.take_texts()] == [
        "Fault: target odometry stuck",
        "Fault over: target odometry stuck",
    ]
    assert [s.time_s for s in seen] == [ms / 1000 for ms in range(0, 4000, 10)]
    frozen = [s for s in seen if s.position_enu_m[0] != s.time_s]
    assert (frozen[0].time_s, frozen[-1].time_s) == (1.51, 2.49)
    assert {s.position_enu_m for s in frozen} == {(1.5, 0.0, 0.2)}


def test_a_robot_with_locked_wheels_stands_at_once_and_drives_on():
    locked = fault(What.ROBOT, Kind.STUCK, start_s=1.0, duration_s=1.0)
    free = load("straight")
    free = replace(free, target=replace(free.target, wait_for_landing=False))
    one, other = (TargetMotion(s, 1, TickGrid(100)) for s in (free, replace(free, fault=(locked,))))
    speeds, places = [], []
    for tick in range(1, 301):
        one.step(driving=True)
        other.step(driving=True)
        speeds.append(math.hypot(*other.model.velocity_enu_m_s[:2]))
        places.append(other.model.pose.position_enu_m)
        if tick <= 100:
            assert other.model.pose == one.model.pose
    assert set(speeds[100:200]) == {0.0}
    assert set(places[100:201]) == {places[99]}
    assert speeds[-1] == pytest.approx(math.hypot(*one.model.velocity_enu_m_s[:2]), abs=1e-3)
    told = [str(text) for _, text in other.take_texts()]
    assert told == ["Fault: robot stuck", "Fault over: robot stuck"]


def test_random_streams_do_not_depend_on_other_faults_being_there():
    alone, both = Schedule(3), Schedule(3)
    garbage = fault(What.MOCAP, Kind.GARBAGE)
    alone.add([garbage])
    both.add([garbage, fault(What.CLOCK, Kind.GARBAGE)])
    draws = [s.due(0)[0].running.rng.random() for s in (alone, both)]
    assert draws[0] == draws[1]
