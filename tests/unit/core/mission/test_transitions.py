"""Tests the texts of phase changes: whether they abort the flight, and their reasons."""

import pytest

from flightstack.core.memory import AbortWay, PlausibilityMemory, TrackMemory
from flightstack.core.mission.machine import Transition, aborts
from flightstack.core.mission.phases import TABLE, Condition, first
from flightstack.core.snapshot import Snapshot, relative
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import ZERO, Inputs, Landed, Mode, OwnState, Phase, VehicleStatus
from tests.unit.core.mission.mission_helpers import mission_of
from tests.unit.core.mission.test_guidance import ROBUST


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (Transition(Phase.LAND, Phase.ABORT, "why", AbortWay.LAND_HERE), True),
        (Transition(Phase.ABORT, Phase.ABORT, "emergency stop", AbortWay.MOTORS_OFF), True),
        (Transition(Phase.LAND, Phase.APPROACH, "ABORT: x"), False),
    ],
)
def test_a_text_tells_whether_the_flight_is_aborted(change, expected):
    assert aborts(change.text) is aborts(change.timed_text(1234567.0)) is expected
    assert not aborts(f"No -> {change.text}")


NOW_S = 10.0
CHECKS = ROBUST.checks


def own(arrival_s=NOW_S):
    return OwnState(arrival_s, arrival_s, ZERO, ZERO, 0.0)


def known(own_state=None, *, status_s=None, target_age_s=None, track=None, **watched):
    status = None if status_s is None else VehicleStatus(status_s, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    target = None if target_age_s is None else TargetState(target_age_s, ZERO, ZERO, 0.0)
    view = Snapshot(Inputs(own_state, status), target, False, False, False, None)
    plausibility = Plausibility(ROBUST)
    plausibility.memory = PlausibilityMemory(**watched)
    seen = TargetTrack(CHECKS)
    seen.memory = TrackMemory(**(track or {}))
    return mission_of(ROBUST, track=seen, plausibility=plausibility), view


def told(phase, word, what):
    mission, view = what
    return mission.reason(first(TABLE[phase], word), word, view, NOW_S)


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (known(), "no state of the vehicle has arrived"),
        (known(own(9.7)), "the vehicle's newest state is 0.30 s old; checks.own_age_max_s is 0.2"),
        (known(own(), last=own(9.7)), "its numbers have not changed for 0.30 s; checks.own_age_max_s is 0.2"),
        (
            known(own(9.7), last=own(9.7)),
            "the vehicle's newest state is 0.30 s old; checks.own_age_max_s is 0.2",
        ),
    ],
)
def test_an_own_state_that_does_not_come_says_how_old_it_is(what, said):
    assert told(Phase.CLIMB, Condition.OWN_LOST, what) == f"own state lost in the climb: {said}"


def test_a_target_says_how_old_it_is_and_why_it_was_refused():
    lost = Condition.TARGET_LOST
    found = told(Phase.LAND, lost, known(target_age_s=0.26))
    assert found == "target lost: the target's newest sample is 0.26 s old; checks.target_age_max_s is 0.25"
    refused = known(target_age_s=0.26, track={"refusal": "jumped"})
    assert told(Phase.LAND, lost, refused).endswith("is 0.25, the newest was refused: jumped")
    parted = told(Phase.LAND, lost, known(track={"distrusted": True, "parted_m": 0.12}))
    assert "positions moved 0.12 m away from where its velocity leads; checks.target_drift_max_m is" in parted
    late = told(Phase.HOLD, lost | Condition.PHASE_TIME_OVER, known(track={"refusal": "not finite"}))
    assert late == (
        "target stayed lost: no sample of the target has been accepted, the newest was refused: not finite"
    )


@pytest.mark.parametrize("was", [Condition.WAS_EXTERNAL, Condition.WAS_ARMED])
def test_a_landing_by_the_autopilot_after_a_jump_of_its_estimate_names_the_jump(was):
    jumped = known(own(), distrusted=True, drift_m=(0.0, 0.0, -1.2))
    plain = told(Phase.LAND, was, jumped)
    assert told(Phase.LAND, was | Condition.OWN_LOST, jumped) == (
        f"{plain}: drift, the position moved 1.20 m away from where its velocity leads; "
        f"checks.own_drift_max_m is {CHECKS.own_drift_max_m:g}"
    )


def test_waiting_in_vain_says_everything_that_is_missing():
    over = Condition.PHASE_TIME_OVER
    lost = over | Condition.OWN_LOST | Condition.TARGET_LOST
    assert told(Phase.WAIT, lost, known()) == (
        "inputs did not become ready in time: no state of the vehicle has arrived, "
        "no sample of the target has been accepted"
    )
    assert told(Phase.WAIT, over, known()).endswith("the vehicle does not report that it is ready to arm")
    ground = VehicleStatus(NOW_S, False, Mode.EXTERNAL, Landed.ON_GROUND, True)
    mission, view = known()
    above = OwnState(0.0, 0.0, (1.0, 0.0, 0.4144), ZERO, 0.0)
    at = relative(above, TargetState(0.0, ZERO, ZERO, 0.0))
    below = view._replace(inputs=Inputs(None, ground), relative=at)
    said = told(Phase.WAIT, over, (mission, below))
    assert "spot is 0.40 m below the ground on which the vehicle stands; checks.target_below_max_m" in said
    ready = over | Condition.READY
    assert told(Phase.WAIT, ready | Condition.RECOVERED, known()) == "inputs did not become ready in time"
    assert "good for 0.3 s without a gap (checks.recovery_time_s)" in told(Phase.WAIT, ready, known())
