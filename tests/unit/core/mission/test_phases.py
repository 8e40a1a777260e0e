"""Every set of conditions in every phase, 2^24 of them, against a second writing of the rules."""

import random

import numpy as np
import pytest

from flightstack.core.mission.phases import DISARMED, SWINGING, TABLE, Condition, next_phase
from flightstack.core.types import Phase

pytestmark = pytest.mark.slow

# only fleets, swinging, the ways of aborting, LANDED and LEAVE ask for the last ones
BITS = len(Condition) - 7
FINAL = (Phase.LANDED, Phase.ABORT)
GOING_ON = [p for p in Phase if p not in FINAL]
STAY = (None, "")
CUT_OFF = (Phase.ABORT, "too few fleet members send messages")
TOO_LOW = (Phase.ABORT, "the battery is too low to land on the target")


class Word:
    """All words at once, or those given: ``word.armed`` is an array of booleans."""

    def __init__(self, words):
        self.words = words

    def __getattr__(self, name):
        return self.words & Condition[name.upper()] != 0


def everything(phase):
    """All words, in pieces small enough for a cache; of the last conditions those that the phase asks for."""
    if phase in (Phase.LANDED, Phase.LEAVE):
        yield np.array(list(mentioned(phase)), np.int32)
        return
    piece = 1 << 18
    for start in range(0, 1 << BITS, piece):
        yield np.arange(start, start + piece, dtype=np.int32)


def operator(w):
    return [
        (w.emergency, Phase.ABORT, "emergency stop"),
        (w.abort_asked, Phase.ABORT, "abort requested by the operator"),
    ]


def in_flight(w):
    return [
        *operator(w),
        (
            w.was_armed & ~w.armed & ~w.link_lost,
            Phase.ABORT,
            DISARMED,
        ),
        (
            w.was_external & ~w.external & ~w.link_lost,
            Phase.ABORT,
            "mode changed without a command from this stack",
        ),
        (w.command_failed, Phase.ABORT, "the vehicle refused a command"),
        (w.not_following, Phase.ABORT, "vehicle does not follow its velocity set-points"),
    ]


def inputs(w):
    return [
        (w.own_lost, Phase.HOLD, "own state lost"),
        (w.link_lost, Phase.HOLD, "heartbeat lost"),
        (w.target_lost, Phase.HOLD, "target lost"),
    ]


def expected_rules(phase, w):
    """The phase rules of docs/how_it_works/method.md on arrays; the first that holds counts."""
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


def outcomes(phase):
    """Every ``(to, reason)`` of both writings, numbered; 0 is to stay."""
    names = {STAY: 0}
    for rule in TABLE[phase]:
        names.setdefault((rule.to, rule.reason), len(names))
    for _, to, reason in expected_rules(phase, Word(np.zeros(1, np.int32))):
        names.setdefault((to, reason), len(names))
    return names


def expected(phase, words, names):
    rules = expected_rules(phase, Word(words))
    if not rules:
        return np.zeros(len(words), np.int8)
    return np.select(
        [c for c, _, _ in rules], [np.int8(names[to, why]) for _, to, why in rules], default=np.int8(0)
    )


def tabled(phase, words, names):
    """The table itself, evaluated from its last rule to its first."""
    found = np.zeros(len(words), np.int8)
    for rule in reversed(TABLE[phase]):
        fires = (words & rule.when == rule.when) & (words & rule.unless == 0)
        found[fires] = names[rule.to, rule.reason]
    return found


def mentioned(phase):
    """All words of the conditions that the phase's rules ask for, the others clear and the others set."""
    mask = 0
    for rule in TABLE[phase]:
        mask |= rule.when | rule.unless
    bits = [1 << n for n in range(len(Condition)) if mask >> n & 1]
    for number in range(1 << len(bits)):
        word = sum(bit for n, bit in enumerate(bits) if number >> n & 1)
        yield word
        yield word | ((1 << len(Condition)) - 1) & ~mask


def test_conditions_are_one_bit_each_and_phases_are_numbered_as_in_the_log():
    assert [int(c) for c in Condition] == [1 << n for n in range(BITS + 7)]
    assert len(Condition.__members__) == BITS + 7 == 31
    asked = 0
    for phase in set(TABLE) - {Phase.LANDED, Phase.LEAVE}:
        rules = TABLE[phase]
        for rule in rules:
            asked |= rule.when | rule.unless | rule.about
    rare = Condition.CUT_OFF | Condition.SWINGS  # these: all words of what a phase asks for, below
    assert asked & ~rare < 1 << BITS
    assert set(TABLE) == set(Phase)
    assert [(p.name, int(p)) for p in Phase] == [
        ("WAIT", 0), ("TAKEOFF", 1), ("APPROACH", 2), ("LAND", 3), ("TOUCHDOWN", 4), ("LANDED", 5),
        ("HOLD", 6), ("CLIMB", 7), ("ABORT", 8), ("LEAVE", 9),
    ]  # fmt: skip


@pytest.mark.parametrize("phase", Phase)
def test_the_table_says_what_was_meant_for_every_word(phase):
    names = outcomes(phase)
    for words in everything(phase):
        assert np.array_equal(tabled(phase, words, names), expected(phase, words, names))


@pytest.mark.parametrize("phase", Phase)
def test_the_machine_does_what_the_table_says(phase):
    names = outcomes(phase)
    chance = random.Random(int(phase))
    asked = [chance.getrandbits(BITS) for _ in range(20_000)] + list(mentioned(phase))
    meant = expected(phase, np.array(asked, np.int32), names)
    rules = [next_phase(phase, word) for word in asked]
    found = [names[STAY if rule is None else (rule.to, rule.reason)] for rule in rules]
    assert np.array_equal(found, meant)


def test_the_emergency_stop_ends_every_phase_in_one_step_whatever_else_is_true():
    for phase in GOING_ON:
        names = outcomes(phase)
        stop = names[Phase.ABORT, "emergency stop"]
        for words in everything(phase):
            stopped = words[words & Condition.EMERGENCY != 0]
            assert (tabled(phase, stopped, names) == stop).all()


def test_nothing_leaves_the_end_but_for_another_vehicle():
    assert TABLE[Phase.ABORT] == ()
    assert {rule.to for rule in TABLE[Phase.LANDED]} == {Phase.LEAVE}
    assert {rule.to for rule in TABLE[Phase.LEAVE]} == set(FINAL)
    chance = random.Random(7)
    for _ in range(20_000):
        word = chance.getrandbits(len(Condition))
        assert next_phase(Phase.ABORT, word) is None
        assert next_phase(Phase.LANDED, word & ~Condition.PAD_WANTED) is None


def reachable(start, allowed):
    """Phases that some row of words leads to, ``allowed`` choosing the words."""
    found, new = set(), {start}
    while new:
        phase = new.pop()
        found.add(phase)
        names = outcomes(phase)
        places = {number: to for (to, _), number in names.items()}
        for words in everything(phase):
            for number in np.unique(tabled(phase, words[allowed(words)], names)):
                if number and places[number] not in found:
                    new.add(places[number])
    return found


def test_without_retries_no_second_attempt_begins():
    def spent(words):
        return words & Condition.RETRIES_LEFT == 0

    for phase in (Phase.HOLD, Phase.CLIMB, Phase.TOUCHDOWN):
        assert reachable(phase, spent) <= {phase, Phase.CLIMB, Phase.LEAVE, *FINAL}


def test_every_way_back_into_the_landing_asks_for_a_retry():
    tries = {Phase.HOLD, Phase.CLIMB, Phase.TOUCHDOWN}
    back = [r for phase in tries for r in TABLE[phase] if r.to in (Phase.APPROACH, Phase.TAKEOFF, Phase.LAND)]
    assert len(back) == 5
    assert all(rule.when & Condition.RETRIES_LEFT for rule in back)
    # what else goes round is approach and land, and that has a time limit of its own
    for phase in (Phase.APPROACH, Phase.LAND):
        assert any(r.when == Condition.LANDING_TIME_OVER and r.to is Phase.ABORT for r in TABLE[phase])


def test_no_flight_lasts_for_ever():
    """Each phase of flight has a limit of its time that leads out of it, whatever else is true."""
    limits = {
        Phase.WAIT: Condition.PHASE_TIME_OVER, Phase.TAKEOFF: Condition.PHASE_TIME_OVER,
        Phase.APPROACH: Condition.LANDING_TIME_OVER, Phase.LAND: Condition.LANDING_TIME_OVER,
        Phase.TOUCHDOWN: Condition.PHASE_TIME_OVER, Phase.HOLD: Condition.PHASE_TIME_OVER,
        Phase.CLIMB: Condition.PHASE_TIME_OVER, Phase.LEAVE: Condition.PHASE_TIME_OVER,
    }  # fmt: skip
    assert set(limits) == set(GOING_ON)
    for phase, limit in limits.items():
        names = outcomes(phase)
        for words in everything(phase):
            assert tabled(phase, words[words & limit != 0], names).all()


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


@pytest.mark.parametrize(
    "lost", [Condition.OWN_LOST, Condition.TARGET_LOST, Condition.LINK_LOST, Condition.READY]
)
def test_a_wait_that_took_too_long_reports_each_input(lost):
    rule = next_phase(Phase.WAIT, Condition.PHASE_TIME_OVER)
    assert rule is not None
    assert rule.to is Phase.ABORT
    assert rule.about & lost
