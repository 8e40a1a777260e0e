"""Every combination of conditions in every phase, compared with an independent statement of the rules."""

import random
from functools import cache

import numpy as np
import pytest

from flightstack.core.mission.phases import DISARMED, SWINGING, TABLE, Condition, first
from flightstack.core.types import Phase

FINAL = (Phase.LANDED, Phase.ABORT)
GOING_ON = [p for p in Phase if p not in FINAL]
IN_FLIGHT = [Phase.TAKEOFF, Phase.APPROACH, Phase.LAND, Phase.HOLD, Phase.CLIMB]
STAY = (None, "")
CUT_OFF = (Phase.ABORT, "too few fleet members send messages")
TOO_LOW = (Phase.ABORT, "the battery is too low to land on the target")
ALL = (1 << len(Condition)) - 1


class Word:
    """Sets of condition flags: ``word.armed`` is an array of booleans. ``asked``: flags that were read."""

    def __init__(self, words):
        self.words, self.asked = words, 0

    def __getattr__(self, name):
        flag = Condition[name.upper()]
        self.asked |= flag
        return self.words & flag != 0


@cache
def everything(phase):
    """Return all combinations of the flags that one of the two implementations reads.

    All other flags are clear in one half of them and set in the other half: they must have no effect.
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


def operator(w):
    return [
        (w.emergency, Phase.ABORT, "emergency stop"),
        (w.abort_asked, Phase.ABORT, "abort requested by the operator"),
    ]


def in_flight(w):
    return [
        *operator(w),
        (w.was_armed & ~w.armed & ~w.link_lost, Phase.ABORT, DISARMED),
        (
            w.was_external & ~w.external & ~w.link_lost,
            Phase.ABORT,
            "mode changed without a command from this stack",
        ),
        (w.command_failed, Phase.ABORT, "the vehicle refused a command"),
        (w.not_following, Phase.ABORT, "vehicle does not follow its velocity set-points"),
        (w.no_result, Phase.ABORT, "the filter returned no velocity"),
    ]


def inputs(w):
    return [
        (w.own_lost, Phase.HOLD, "own state lost"),
        (w.link_lost, Phase.HOLD, "heartbeat lost"),
        (w.target_lost, Phase.HOLD, "target lost"),
    ]


def expected_rules(phase, w):
    """The phase rules of docs/how_it_works/method.md on arrays; the first rule that applies counts."""
    again = w.recovered & w.retries_left
    match phase:
        case Phase.WAIT:
            return [
                *operator(w),
                (w.command_failed, Phase.ABORT, "the vehicle refused a command"),
                (w.phase_time_over, Phase.ABORT, "inputs did not become ready in time"),
                (w.tired & w.external & ~w.standing, *TOO_LOW),
                (w.ready & w.external & ~w.standing, Phase.APPROACH, "flying and all inputs fresh"),
                (w.ready & w.recovered & w.standing, Phase.TAKEOFF, "all inputs fresh"),
            ]
        case Phase.TAKEOFF:
            return [
                *in_flight(w),
                *inputs(w),
                (w.tired, *TOO_LOW),
                (w.cut_off, *CUT_OFF),
                (w.phase_time_over, Phase.ABORT, "start not reached in time"),
                (w.at_start & w.external, Phase.APPROACH, "start reached"),
            ]
        case Phase.APPROACH:
            return [
                *in_flight(w),
                *inputs(w),
                (w.tired, *TOO_LOW),
                (w.cut_off, *CUT_OFF),
                (w.landing_time_over, Phase.ABORT, "landing took too long"),
                (w.over_pad, Phase.LAND, "inside the descending cone"),
            ]
        case Phase.LAND:
            return [
                *in_flight(w),
                *inputs(w),
                (w.landing_time_over, Phase.ABORT, "landing took too long"),
                (w.touch, Phase.TOUCHDOWN, "touchdown rule met"),
                (w.swings, Phase.ABORT, SWINGING),
                (~w.over_pad, Phase.APPROACH, "left the descending cone"),
            ]
        case Phase.TOUCHDOWN:
            return [
                *operator(w),
                (w.was_armed & ~w.armed & ~w.link_lost, Phase.LANDED, "motors off"),
                (w.own_lost, Phase.ABORT, "own state lost at touchdown"),
                (w.not_following, Phase.ABORT, "vehicle does not follow its velocity set-points"),
                (w.drifted & w.retries_left, Phase.APPROACH, "going to miss the pad: go around"),
                (w.drifted, Phase.ABORT, "going to miss the pad, and no retry left"),
                (w.phase_time_over, Phase.ABORT, "no contact, or motors did not stop"),
            ]
        case Phase.HOLD:
            return [
                *in_flight(w),
                (w.cut_off, *CUT_OFF),
                (again & w.started, Phase.APPROACH, "inputs good again"),
                (again, Phase.TAKEOFF, "inputs good again"),
                (w.phase_time_over & w.own_lost, Phase.ABORT, "own state stayed lost"),
                (w.phase_time_over & w.link_lost, Phase.ABORT, "heartbeat stayed lost"),
                (w.tired & ~w.own_lost & ~w.link_lost, *TOO_LOW),
                (w.phase_time_over, Phase.CLIMB, "target stayed lost"),
            ]
        case Phase.CLIMB:
            return [
                *in_flight(w),
                (w.own_lost, Phase.ABORT, "own state lost in the climb"),
                (w.link_lost, Phase.ABORT, "heartbeat lost in the climb"),
                (w.tired, *TOO_LOW),
                (w.cut_off, *CUT_OFF),
                (again & w.high_enough & w.started, Phase.APPROACH, "target back"),
                (again & w.high_enough & ~w.started, Phase.TAKEOFF, "target back"),
                (w.phase_time_over, Phase.ABORT, "target did not come back"),
            ]
        case Phase.LANDED:
            free = w.pad_wanted & ~w.emergency & ~w.abort_asked
            return [(free, Phase.LEAVE, "another vehicle waits for this pad")]
        case Phase.LEAVE:
            lost = [(flag, Phase.ABORT, why) for flag, _, why in inputs(w)]
            return [
                *operator(w),
                (
                    w.was_armed & ~w.armed & ~w.link_lost & w.clear,
                    Phase.LANDED,
                    "motors off beside the target",
                ),
                (
                    w.command_failed & w.standing & ~w.armed,
                    Phase.LANDED,
                    "no further take-off: remains on the pad",
                ),
                *((flag & ~w.clear, to, why) for flag, to, why in [*in_flight(w)[2:], *lost]),
                (w.phase_time_over, Phase.ABORT, "the pad was not left in time"),
            ]
    return []


def expected(phase, words):
    """Return the outcome number of each word, and the outcomes ``(to, reason)`` by number; 0: no change."""
    rules = expected_rules(phase, Word(words))
    outcomes = list(dict.fromkeys([STAY, *((to, why) for _, to, why in rules)]))
    numbers = [outcomes.index((to, why)) for _, to, why in rules]
    found = np.select([c for c, _, _ in rules], numbers) if rules else np.zeros(len(words), int)
    return found, outcomes


def leads_to(phase, asked=0, unless=0):
    """Return the next phase of all words with these conditions and without those; None: no change."""
    words = everything(phase)
    found, outcomes = expected(phase, words[(words & asked == asked) & (words & unless == 0)])
    return {outcomes[number][0] for number in np.unique(found)}


def test_conditions_are_one_bit_each_and_phases_are_numbered_as_in_the_log():
    assert [int(c) for c in Condition.__members__.values()] == [1 << n for n in range(32)]
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
    """Return the phases that follow from some row of words without these conditions."""
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
    """Each phase of flight has a time limit that ends it, independent of all other conditions."""
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
