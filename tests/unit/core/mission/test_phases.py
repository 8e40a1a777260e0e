"""Compares the next phase for every combination of conditions with an independent statement of the rules."""

import random
from functools import cache

import numpy as np
import pytest

from flightstack.core.mission.machine import COMPUTED, EXCLUDED, masks
from flightstack.core.mission.phases import DISARMED, ORDINARY, TABLE, Condition, Rule, first
from flightstack.core.types import Phase

FINAL = (Phase.LANDED, Phase.ABORT)
GOING_ON = [p for p in Phase if p not in FINAL]
IN_FLIGHT = [Phase.TAKEOFF, Phase.APPROACH, Phase.LAND, Phase.HOLD, Phase.CLIMB]
STAY = (None, "")
ALL = (1 << len(Condition)) - 1


# The phase rules of docs/how_it_works/method.md: in each block, the first rule whose condition holds decides.
# "= NAME" stands for all rules of the block NAME; "while" adds a condition to each of these rules.
STATED = f"""
OPERATOR
emergency -> ABORT: emergency stop
abort_asked -> ABORT: abort requested by the operator
VEHICLE
was_armed & ~armed & ~link_lost -> ABORT: {DISARMED}
was_external & ~external & ~link_lost -> ABORT: mode changed without a command from this stack
command_failed -> ABORT: the vehicle refused a command
not_following -> ABORT: vehicle does not follow its velocity set-points
no_result -> ABORT: the filter returned no velocity
INPUTS
own_lost -> HOLD: own state lost
link_lost -> HOLD: heartbeat lost
target_lost -> HOLD: target lost
LOST
own_lost -> ABORT: own state lost
link_lost -> ABORT: heartbeat lost
target_lost -> ABORT: target lost
CUT_OFF
cut_off -> ABORT: too few fleet members send messages
TIRED
tired -> ABORT: the battery is too low to land on the target
CHECK
check_failed -> ABORT: a check of the landing failed

WAIT
= OPERATOR
command_failed -> ABORT: the vehicle refused a command
phase_time_over -> ABORT: inputs did not become ready in time
= TIRED while external & ~standing
ready & external & ~standing -> APPROACH: flying and all inputs fresh
ready & recovered & standing -> TAKEOFF: all inputs fresh
TAKEOFF
= OPERATOR, VEHICLE, INPUTS, TIRED, CUT_OFF, CHECK
phase_time_over -> ABORT: start not reached in time
at_start & external -> APPROACH: start reached
APPROACH
= OPERATOR, VEHICLE, INPUTS, TIRED, CUT_OFF
landing_time_over -> ABORT: landing took too long
= CHECK
over_pad -> LAND: inside the descending cone
LAND
= OPERATOR, VEHICLE, INPUTS
landing_time_over -> ABORT: landing took too long
touch -> TOUCHDOWN: touchdown rule met
= CHECK
~over_pad -> APPROACH: left the descending cone
TOUCHDOWN
= OPERATOR
was_armed & ~armed & ~link_lost -> LANDED: motors off
own_lost -> ABORT: own state lost at touchdown
not_following -> ABORT: vehicle does not follow its velocity set-points
= CHECK
drifted & retries_left -> APPROACH: going to miss the pad: go around
drifted -> ABORT: going to miss the pad, and no retry left
set_off & retries_left -> APPROACH: the target has become too fast: go around
set_off -> ABORT: the target has become too fast, and the battery allows no go-around
phase_time_over -> ABORT: no contact, or motors did not stop
HOLD
= OPERATOR, VEHICLE, CUT_OFF
recovered & retries_left & started -> APPROACH: inputs good again
recovered & retries_left -> TAKEOFF: inputs good again
phase_time_over & own_lost -> ABORT: own state stayed lost
phase_time_over & link_lost -> ABORT: heartbeat stayed lost
= TIRED while ~own_lost & ~link_lost
phase_time_over -> CLIMB: target stayed lost
CLIMB
= OPERATOR, VEHICLE
own_lost -> ABORT: own state lost in the climb
link_lost -> ABORT: heartbeat lost in the climb
= TIRED, CUT_OFF
recovered & retries_left & high_enough & started -> APPROACH: target back
recovered & retries_left & high_enough & ~started -> TAKEOFF: target back
phase_time_over -> ABORT: target did not come back
LANDED
pad_wanted & ~emergency & ~abort_asked -> LEAVE: another vehicle waits for this pad
ABORT
LEAVE
= OPERATOR
was_armed & ~armed & ~link_lost & clear -> LANDED: motors off beside the target
command_failed & standing & ~armed -> LANDED: no further take-off: remains on the pad
= VEHICLE, LOST while ~clear
phase_time_over -> ABORT: the pad was not left in time
"""


def blocks():
    """Return the stated rules of each block: condition, next phase and reason."""
    found, rules = {}, []
    for line in STATED.split("\n"):
        when, _, then = line.partition(" -> ")
        if line.startswith("= "):
            names, _, more = line[2:].partition(" while ")
            for name in names.split(", "):
                rules += [(f"({when}) & {more}" if more else when, to, why) for when, to, why in found[name]]
        elif then:
            to, _, why = then.partition(": ")
            rules.append((when, Phase[to], why))
        elif line:
            rules = found[line] = []
    return found


BLOCKS = blocks()


class Word(dict):
    """Sets of condition flags: ``word["armed"]`` has a boolean for each set. ``asked``: flags read so far."""

    def __init__(self, words):
        self.words, self.asked = words, 0

    def __missing__(self, name):
        flag = Condition[name.upper()]
        self.asked |= flag
        return self.words & flag != 0


def expected_rules(phase, word):
    return [(eval(when, {}, word), to, why) for when, to, why in BLOCKS[phase.name]]


@cache
def everything(phase):
    """Return all combinations of the flags that at least one of the two implementations reads.

    The other flags must have no effect: in half of the combinations they are clear, in the other half set.
    """
    word = Word(np.zeros(1, np.int64))
    expected_rules(phase, word)
    mask = word.asked
    for rule in TABLE[phase]:
        mask |= rule.when | rule.unless
    words = np.zeros(1, np.int64)
    for flag in Condition:
        if mask & flag:
            words = np.concatenate((words, words | np.int64(flag)))
    return np.concatenate((words, words | np.int64(ALL & ~mask)))


def expected(phase, words):
    """Return for each set of flags the number of the outcome (0: no change), and all outcomes."""
    rules = expected_rules(phase, Word(words))
    outcomes = list(dict.fromkeys([STAY, *((to, why) for _, to, why in rules)]))
    numbers = [outcomes.index((to, why)) for _, to, why in rules]
    found = np.select([c for c, _, _ in rules], numbers) if rules else np.zeros(len(words), int)
    return found, outcomes


def leads_to(phase, asked=0, unless=0):
    """Return the next phases for all sets with all of ``asked`` and none of ``unless``; None: no change."""
    words = everything(phase)
    found, outcomes = expected(phase, words[(words & asked == asked) & (words & unless == 0)])
    return {outcomes[number][0] for number in np.unique(found)}


def test_conditions_are_one_bit_each_and_phases_are_numbered_as_in_the_log():
    assert [int(c) for c in Condition.__members__.values()] == [1 << n for n in range(33)]
    assert set(TABLE) == set(Phase)
    assert [(p.name, int(p)) for p in Phase] == [
        ("WAIT", 0), ("TAKEOFF", 1), ("APPROACH", 2), ("LAND", 3), ("TOUCHDOWN", 4), ("LANDED", 5),
        ("HOLD", 6), ("CLIMB", 7), ("ABORT", 8), ("LEAVE", 9),
    ]  # fmt: skip


@pytest.mark.parametrize("phase", Phase)
def test_the_machine_does_what_was_meant_for_every_word_and_every_rule_can_fire(phase):
    chance = random.Random(int(phase))
    asked = [chance.getrandbits(len(Condition)) for _ in range(20_000)] + everything(phase).tolist()
    found, outcomes = expected(phase, np.array(asked, np.int64))
    rules = [first(TABLE[phase], word) for word in asked]
    machine = [STAY if rule is None else (rule.to, rule.reason) for rule in rules]
    assert machine == [outcomes[number] for number in found.tolist()]
    assert set(rules) - {None} == set(TABLE[phase])


def test_the_emergency_stop_ends_every_phase_in_one_step_whatever_else_is_true():
    for phase in GOING_ON:
        words = everything(phase)
        found, outcomes = expected(phase, words[words & Condition.EMERGENCY != 0])
        assert [outcomes[number] for number in np.unique(found)] == [(Phase.ABORT, "emergency stop")]


def test_nothing_leaves_the_end_but_for_another_vehicle():
    assert leads_to(Phase.ABORT) == leads_to(Phase.LANDED, unless=Condition.PAD_WANTED) == {None}
    assert leads_to(Phase.LANDED) == {None, Phase.LEAVE}
    assert leads_to(Phase.LEAVE) == {None, *FINAL}


def reachable(start, unless=0):
    """Return all phases that can follow ``start``, directly or later, while ``unless`` is clear."""
    found, new = set(), {start}
    while new:
        phase = new.pop()
        found.add(phase)
        new |= leads_to(phase, unless=unless) - found - {None}
    return found


def test_without_retries_no_second_attempt_begins():
    for phase in (Phase.HOLD, Phase.CLIMB, Phase.TOUCHDOWN):
        assert reachable(phase, Condition.RETRIES_LEFT) <= {phase, Phase.CLIMB, Phase.LEAVE, *FINAL}


def test_every_phase_is_reachable():
    assert reachable(Phase.WAIT) == set(Phase)


def test_no_flight_lasts_for_ever():
    """When its time limit is reached, each phase of flight ends, independent of all other conditions."""
    for phase in GOING_ON:
        landing = phase in (Phase.APPROACH, Phase.LAND)
        limit = Condition.LANDING_TIME_OVER if landing else Condition.PHASE_TIME_OVER
        assert None not in leads_to(phase, limit)


@pytest.mark.parametrize("phase", IN_FLIGHT)
def test_a_disarmed_vehicle_is_never_flown_on(phase):
    assert leads_to(phase, Condition.WAS_ARMED, Condition.ARMED | Condition.LINK_LOST) == {Phase.ABORT}


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.LAND])
@pytest.mark.parametrize("lost", [Condition.OWN_LOST, Condition.TARGET_LOST, Condition.LINK_LOST])
def test_no_landing_goes_on_without_its_inputs(phase, lost):
    assert leads_to(phase, lost) <= {Phase.HOLD, Phase.ABORT}


def test_motors_go_off_only_from_land_and_only_by_the_touchdown_rule():
    assert [phase for phase in Phase if Phase.TOUCHDOWN in leads_to(phase)] == [Phase.LAND]
    assert Phase.TOUCHDOWN not in leads_to(Phase.LAND, unless=Condition.TOUCH)


def test_a_flag_that_compiled_ticks_would_miss_is_refused(monkeypatch):
    rule = Rule(Condition.AT_START, Phase.ABORT, "a new rule")
    monkeypatch.setitem(TABLE, Phase.LAND, (*TABLE[Phase.LAND], rule))
    with pytest.raises(ValueError, match=r"LAND, 'a new rule': found AT_START; add the flag to COMPUTED"):
        masks(ORDINARY)
    assert COMPUTED & EXCLUDED == 0
