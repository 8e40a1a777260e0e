"""Tests faults of the sample streams: which samples arrive, in which order, and the limit of the queue."""

import pytest

from sim.faults.samples import HELD_MAX, EstimateFaults, SampleFaults, Shape
from sim.faults.schedule import ScheduledFaults
from sim.plant.sensors import NEVER_NS, NS
from sim.plant.states import Estimate
from sim.runners.robot import TargetFaults
from sim.scenarios.fault_spec import TABLE, After, Kind, What
from tests.unit.faults.fault_helpers import fault, running

MS = NS // 1000
SHAPE = Shape(lambda s, o, turn: (s[0], s[1] + o[0], s[2] + turn), lambda first, now: (now[0], *first[1:]))


def flow(*faults, seconds=5.0, end_s=None):
    """Send samples at 100 Hz, with faults from 1 s on; return (arrived_ms, (sent_ms, x, yaw)) of arrivals.

    The value x of a sample is the time at which it is sent, s.
    """
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


@pytest.mark.parametrize("kind", TABLE[What.MOCAP])
def test_before_and_after_a_fault_samples_are_as_they_were(kind):
    out = flow(mocap(kind), end_s=3.0)
    assert [(ms, s[0], s[1]) for ms, s in out if ms < 1000] == [
        (ms, ms, ms / 1000) for ms in range(0, 1000, 10)
    ]
    late = [(ms, s) for ms, s in out if ms > 3000]
    assert late == [(ms, (ms, ms / 1000, 0.0)) for ms in range(3010, 5000, 10)]


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


def target(time_s: float) -> tuple[float, ...]:
    return (time_s, time_s, 0.0, 0.2, 3.0, 0.1, 0.0, 0.0, 0.0)


def test_faults_of_the_target_wait_for_the_landing_and_are_told():
    spec = fault(What.TARGET_ODOMETRY, Kind.STUCK, start_s=0.5, duration_s=1.0, after=After.LANDING)
    faults = TargetFaults([spec, fault(What.MOTOR, Kind.DEAD)], 1)
    seen = []
    for ms in range(0, 4000, 10):
        if ms >= 1000:
            faults.refer(After.LANDING, 1000 * MS)  # a repeated call has no effect
        seen += faults.deliver(ms * MS, [target(ms / 1000)])
    assert [str(t) for t in faults.take_texts()] == [
        "Fault: target odometry stuck",
        "Fault over: target odometry stuck",
    ]
    assert [s[0] for s in seen] == [ms / 1000 for ms in range(0, 4000, 10)]
    frozen = [s for s in seen if s[1] != s[0]]
    assert (frozen[0][0], frozen[-1][0]) == (1.51, 2.49)
    assert {s[1:4] for s in frozen} == {(1.5, 0.0, 0.2)}


def test_random_streams_do_not_depend_on_other_faults_being_there():
    garbage, draws = fault(What.MOCAP, Kind.GARBAGE), []
    for others in ((), (fault(What.CLOCK, Kind.GARBAGE),)):
        stage = SampleFaults(SHAPE)
        faults = ScheduledFaults([garbage, *others], 3, {What.MOCAP: stage, What.CLOCK: SampleFaults(SHAPE)})
        faults.run(0)
        draws.append(stage.deliver(0, [(0, 0.0, 0.0)]))
    assert draws[0] == draws[1] != [(0, 0.0, 0.0)]
