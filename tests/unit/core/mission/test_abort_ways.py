"""Tests the end of the flight after an abort, for every combination of its conditions."""

from flightstack.core.memory import AbortWay
from flightstack.core.mission.phases import ABORT_TABLE, Condition, first


def way_of(w):
    """Return the expected end of an abort by independent rules. ``w``: names of the true conditions."""
    if "EMERGENCY" in w:
        return AbortWay.MOTORS_OFF
    if "WAS_ARMED" not in w:
        return AbortWay.HANDS_OFF
    if "ARMED" not in w:
        return AbortWay.HANDS_OFF if "STANDING" in w else AbortWay.LAND_HERE
    if "STANDING" in w:
        return AbortWay.LAND_HERE
    if "WAS_EXTERNAL" in w and not w & {"EXTERNAL", "LINK_LOST"}:
        return AbortWay.HANDS_OFF
    if w & {"LAND_ASKED", "OWN_LOST", "LINK_LOST", "COMMAND_FAILED", "NOT_FOLLOWING", "ON_PAD", "CUT_OFF"}:
        return AbortWay.LAND_HERE
    return AbortWay.FLY_CLEAR if "TARGET_KNOWN" in w else AbortWay.LAND_HERE


ASKED_OF_WAYS = [
    Condition.EMERGENCY, Condition.WAS_ARMED, Condition.ARMED, Condition.STANDING, Condition.WAS_EXTERNAL,
    Condition.EXTERNAL, Condition.LINK_LOST, Condition.LAND_ASKED, Condition.OWN_LOST,
    Condition.COMMAND_FAILED, Condition.NOT_FOLLOWING, Condition.TARGET_KNOWN, Condition.ON_PAD,
    Condition.CUT_OFF,
]  # fmt: skip


def test_an_abort_ends_the_flight_as_was_meant_for_every_set_of_conditions():
    others = (1 << len(Condition)) - 1 & ~sum(ASKED_OF_WAYS)
    for number in range(1 << len(ASKED_OF_WAYS)):
        chosen = [c for n, c in enumerate(ASKED_OF_WAYS) if number >> n & 1]
        meant = way_of({c.name for c in chosen})
        for flags in (sum(chosen), sum(chosen) | others):
            assert first(ABORT_TABLE[AbortWay.NONE], flags).to is meant


def test_an_abort_changes_its_way_only_where_a_person_asks_for_more():
    assert set(ABORT_TABLE) == set(AbortWay)
    for number in range(1 << len(ASKED_OF_WAYS)):
        flags = sum(c for n, c in enumerate(ASKED_OF_WAYS) if number >> n & 1)
        for way in (AbortWay.HANDS_OFF, AbortWay.LAND_HERE, AbortWay.FLY_CLEAR):
            rule = first(ABORT_TABLE[way], flags)
            if flags & Condition.EMERGENCY:
                assert (rule.to, rule.reason) == (AbortWay.MOTORS_OFF, "emergency stop")
            elif way is AbortWay.FLY_CLEAR and flags & Condition.LAND_ASKED:
                assert (rule.to, rule.reason) == (AbortWay.LAND_HERE, "ended by the operator")
            else:
                assert rule is None
        assert first(ABORT_TABLE[AbortWay.MOTORS_OFF], flags) is None
