"""A change of phase says what was found and the key that bounds it."""

import pytest

from flightstack.core.memory import PlausibilityMemory
from flightstack.core.mission.conditions import Known, reason
from flightstack.core.mission.phases import Condition, next_phase
from flightstack.core.snapshot import Snapshot
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.track import TargetState
from flightstack.core.types import ZERO, Inputs, Landed, Mode, OwnState, Phase, VehicleStatus
from tests.unit.core.mission.test_guidance import ROBUST

NOW_S = 10.0
CHECKS = ROBUST.checks


def own(arrival_s=NOW_S):
    return OwnState(arrival_s, arrival_s, ZERO, ZERO, 0.0)


def known(own_state=None, *, status_s=None, target_age_s=None, refusal="", **watched):
    status = None if status_s is None else VehicleStatus(status_s, True, Mode.EXTERNAL, Landed.IN_AIR, True)
    target = None if target_age_s is None else TargetState(target_age_s, ZERO, ZERO, 0.0)
    view = Snapshot(Inputs(own_state, status), target, False, False, False, None)
    plausibility = Plausibility(ROBUST)
    plausibility.memory = PlausibilityMemory(**watched)
    return Known(CHECKS, view, plausibility, refusal, NOW_S)


def told(phase, word, what):
    return reason(next_phase(phase, word), word, what)


def test_a_drift_says_how_far_and_what_bounds_it():
    found = told(Phase.APPROACH, Condition.OWN_LOST, known(own(), distrusted=True, drift_m=(0.3, 0.0, 0.3)))
    assert found == (
        "own state lost: drift, the position went 0.42 m where no velocity took it; "
        f"checks.own_drift_max_m is {CHECKS.own_drift_max_m:g}"
    )


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (known(), "no own state has come"),
        (known(own(9.7)), "the own state is 0.30 s old; checks.own_age_max_s is 0.2"),
        (known(own(), last=own(9.7)), "its numbers repeat since 0.30 s; checks.own_age_max_s is 0.2"),
        (known(own(9.7), last=own(9.7)), "the own state is 0.30 s old; checks.own_age_max_s is 0.2"),
    ],
)
def test_an_own_state_that_does_not_come_says_how_old_it_is(what, said):
    assert told(Phase.CLIMB, Condition.OWN_LOST, what) == f"own state lost in the climb: {said}"


def test_a_heartbeat_says_how_old_it_is():
    found = told(Phase.LAND, Condition.LINK_LOST, known(status_s=6.5))
    assert found == "heartbeat lost: the newest heartbeat is 3.5 s old; checks.status_age_max_s is 3"
    assert told(Phase.LAND, Condition.LINK_LOST, known()) == "heartbeat lost: no heartbeat has come"


def test_a_target_says_how_old_it_is_and_why_it_was_refused():
    lost = Condition.TARGET_LOST
    found = told(Phase.LAND, lost, known(target_age_s=0.26))
    assert found == "target lost: the target's newest sample is 0.26 s old; checks.target_age_max_s is 0.25"
    refused = known(target_age_s=0.26, refusal="jumped")
    assert told(Phase.LAND, lost, refused).endswith("is 0.25, the newest was refused: jumped")
    late = told(Phase.HOLD, lost | Condition.PHASE_TIME_OVER, known(refusal="not finite"))
    assert late == (
        "target stayed lost: no sample of the target has been accepted, the newest was refused: not finite"
    )


def test_a_vehicle_that_does_not_follow_says_how_far_it_lags():
    found = told(Phase.APPROACH, Condition.NOT_FOLLOWING, known(missed_m=(0.0, -0.3, 0.0)))
    most_m = CHECKS.follow_lag_max_s * max(ROBUST.limits.velocity_max_m_s[:2])
    assert found == (
        f"the vehicle does not fly what it is told: it lags 0.30 m behind its set-points; {most_m:.2f} m are "
        f"allowed by checks.follow_lag_max_s, {CHECKS.follow_lag_max_s:g}"
    )


def test_waiting_in_vain_says_everything_that_is_missing():
    over = Condition.PHASE_TIME_OVER
    lost = over | Condition.OWN_LOST | Condition.TARGET_LOST
    assert told(Phase.WAIT, lost, known()) == (
        "inputs did not become ready in time: no own state has come, "
        "no sample of the target has been accepted"
    )
    assert told(Phase.WAIT, over, known()).endswith("the vehicle does not say that it is ready to arm")
    assert told(Phase.WAIT, over | Condition.READY, known()) == "inputs did not become ready in time"


def test_other_reasons_stay_as_the_table_has_them():
    assert told(Phase.WAIT, Condition.EMERGENCY | Condition.OWN_LOST, known()) == "emergency stop"
