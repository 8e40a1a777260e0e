"""The phase table: what must hold in every phase and for every word of conditions."""

import random

import pytest

from flightstack.core.mission.phases import TABLE, Condition, next_phase
from flightstack.core.types import Phase

ALL = list(Condition)
IN_FLIGHT = [Phase.TAKEOFF, Phase.APPROACH, Phase.LAND, Phase.HOLD, Phase.CLIMB]
CAN_END = [p for p in Phase if p not in (Phase.LANDED, Phase.ABORT)]


def words(seed, count=4000):
    chance = random.Random(seed)
    for _ in range(count):
        word = 0
        for flag in ALL:
            if chance.random() < 0.5:
                word |= flag
        yield word


def change(phase, word):
    """Next phase and reason, None if the phase stays."""
    rule = next_phase(phase, word)
    return None if rule is None else (rule.to, rule.reason)


def test_the_table_is_complete():
    assert set(TABLE) == set(Phase)


@pytest.mark.parametrize("phase", CAN_END)
def test_the_emergency_stop_works_in_every_phase_and_every_word(phase):
    for word in words(1):
        assert change(phase, word | Condition.EMERGENCY) == (Phase.ABORT, "emergency stop")


@pytest.mark.parametrize("phase", IN_FLIGHT)
def test_a_disarmed_vehicle_is_never_flown_on(phase):
    off = Condition.WAS_ARMED
    for word in words(2):
        seen = (word | off) & ~Condition.ARMED & ~Condition.LINK_LOST
        assert change(phase, seen)[0] is Phase.ABORT


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.LAND])
@pytest.mark.parametrize("lost", [Condition.OWN_LOST, Condition.TARGET_LOST, Condition.LINK_LOST])
def test_no_landing_goes_on_without_its_inputs(phase, lost):
    for word in words(3):
        assert change(phase, word | lost)[0] in (Phase.HOLD, Phase.ABORT)


@pytest.mark.parametrize("phase", [Phase.LANDED, Phase.ABORT])
def test_there_is_no_way_back_from_the_end(phase):
    assert all(change(phase, word) is None for word in words(4))


def test_motors_go_off_only_from_land_and_only_by_the_touchdown_rule():
    for phase in Phase:
        for word in words(5):
            found = change(phase, word)
            if found is not None and found[0] is Phase.TOUCHDOWN:
                assert phase is Phase.LAND
                assert word & Condition.TOUCH


def test_every_phase_is_reachable_and_every_rule_can_fire():
    reached = {Phase.WAIT}
    for _ in Phase:
        reached |= {rule.to for phase in reached for rule in TABLE[phase]}
    assert reached == set(Phase)
    for phase, rules in TABLE.items():
        for rule in rules:
            tried = ((word & ~rule.unless) | rule.when for word in words(6, 20_000))
            assert any(change(phase, word) == (rule.to, rule.reason) for word in tried), (phase, rule)


def test_a_go_around_needs_height_retries_and_good_inputs():
    good = (
        Condition.RECOVERED | Condition.STARTED | Condition.RETRIES_LEFT | Condition.HIGH_ENOUGH
        | Condition.ARMED | Condition.WAS_ARMED | Condition.EXTERNAL | Condition.WAS_EXTERNAL
    )  # fmt: skip
    assert change(Phase.CLIMB, good)[0] is Phase.APPROACH
    for needed in (Condition.RECOVERED, Condition.RETRIES_LEFT, Condition.HIGH_ENOUGH):
        assert change(Phase.CLIMB, good & ~needed) is None


@pytest.mark.parametrize(
    "lost", [Condition.OWN_LOST, Condition.TARGET_LOST, Condition.LINK_LOST, Condition.READY]
)
def test_a_wait_that_took_too_long_reports_each_input(lost):
    rule = next_phase(Phase.WAIT, Condition.PHASE_TIME_OVER)
    assert rule is not None
    assert rule.to is Phase.ABORT
    assert rule.about & lost
