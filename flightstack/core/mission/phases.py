"""Mission as tables: in each phase, the first rule whose conditions hold gives the next phase.

``conditions.py`` computes the ``Condition`` flags in each tick; a rule fires when all flags of ``when`` and
none of ``unless`` are set. Nothing else changes a phase.

A go-around is a change to APPROACH or TAKEOFF that uses a retry: from TOUCHDOWN (DRIFTED or SET_OFF), or from
HOLD or CLIMB (RECOVERED). LAND -> APPROACH is not a go-around: the vehicle left the cone; a check counts
these cases.

The kinds of abort (``AbortWay``) have their own table: the rules of ``AbortWay.NONE`` choose the kind when an
abort starts. No rule leaves ABORT. Phase LANDED is left at most once, to free the pad for another fleet
member; for another flight the operator starts a new process.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Generic, TypeVar

from flightstack.common.text import FILTER_FAILED
from flightstack.core.memory import AbortWay
from flightstack.core.types import Phase

To = TypeVar("To", Phase, AbortWay)


class Condition(IntEnum):
    """Conditions that the tables use, one bit each. The flags of a tick are a plain int, for speed."""

    EMERGENCY = 1 << 0  # emergency stop by the operator
    ABORT_ASKED = 1 << 1  # abort requested by the operator
    OWN_LOST = 1 << 2  # the vehicle state is missing, too old or implausible
    LINK_LOST = 1 << 3  # the heartbeat is missing or too old
    TARGET_LOST = 1 << 4  # the target state is missing, too old or implausible
    READY = 1 << 5  # inputs and battery are good; the vehicle is armed or ready; the fleet permits a start
    ARMED = 1 << 6
    WAS_ARMED = 1 << 7  # the vehicle was armed earlier in this flight
    EXTERNAL = 1 << 8  # the vehicle follows set-points of this stack
    WAS_EXTERNAL = 1 << 9  # the vehicle followed set-points earlier in this flight
    STANDING = 1 << 10  # the vehicle reports ground contact
    AT_START = 1 << 11  # the vehicle is at the start point of the landing and moves with the target
    STARTED = 1 << 12  # the landing has started
    OVER_PAD = 1 << 13  # the vehicle is inside the descending cone
    TOUCH = 1 << 14  # the touchdown rule is met
    RECOVERED = 1 << 15  # inputs were good for ``recovery_time_s``; in WAIT also: inputs arrived in this time
    RETRIES_LEFT = 1 << 16  # a go-around is allowed
    HIGH_ENOUGH = 1 << 17  # the vehicle is above every part of the target
    PHASE_TIME_OVER = 1 << 18  # the maximum time allowed in this phase is over
    LANDING_TIME_OVER = 1 << 19  # the landing or the wait for the right of way takes too long
    COMMAND_FAILED = 1 << 20  # the vehicle has refused a command, also after repetitions
    # in TOUCHDOWN, with enough h to climb away: the vehicle is about to leave the corridor above the pad
    DRIFTED = 1 << 21
    NOT_FOLLOWING = 1 << 22  # the vehicle does not follow the commanded velocity
    TIRED = 1 << 23  # the battery is too low, and the pad is not the shortest way down
    LAND_ASKED = 1 << 24  # abort with a landing by the autopilot, requested by the operator
    TARGET_KNOWN = 1 << 25  # a target position was received, possibly long ago
    ON_PAD = 1 << 26  # contact with the pad was detected in phase TOUCHDOWN
    PAD_WANTED = 1 << 27  # another vehicle waits for this vehicle's pad; inputs and battery are good
    CLEAR = 1 << 28  # the vehicle has flown clear of the target, and lands beside the target
    CUT_OFF = 1 << 29  # too few fleet members send messages, and the pad is not the shortest way down
    CHECK_FAILED = 1 << 30  # a check in ``conditions.check_fails`` ends the flight and gives the reason
    NO_RESULT = 1 << 31  # the user's filter returned no velocity in the last tick
    # in TOUCHDOWN, with enough h to climb away and retries left: a slow target has become fast
    SET_OFF = 1 << 32


C = Condition
NONE = 0
FLYING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN})
ORDINARY = FLYING | {Phase.LANDED}  # phases that ``Controller.land`` can run


@dataclass(frozen=True, slots=True)
class Rule(Generic[To]):
    """Rule of a table: go to ``to`` when all of ``when`` and none of ``unless`` hold, with ``reason``.

    ``about``: additional conditions whose measured values are written after the reason.
    """

    when: int
    to: To
    reason: str
    unless: int = NONE
    about: int = NONE


_LOSSES = C.OWN_LOST | C.LINK_LOST | C.TARGET_LOST
_TO_BEGIN = _LOSSES | C.TIRED | C.READY | C.RECOVERED
_OPERATOR = (
    Rule(C.EMERGENCY, Phase.ABORT, "emergency stop"),
    Rule(C.ABORT_ASKED, Phase.ABORT, "abort requested by the operator"),
)
TIME_OVER = "the time of the flight is over: duration_max_s of the scenario, or --duration"
# reasons of changes by the autopilot or another client; the autopilot's messages contain the cause
DISARMED, MODE_CHANGED = (
    "vehicle disarmed without a command from this stack",
    "mode changed without a command from this stack",
)
_IN_FLIGHT = (
    *_OPERATOR,
    # after a jump of its position estimate the autopilot can land the vehicle: the reason names the jump
    Rule(C.WAS_ARMED, Phase.ABORT, DISARMED, unless=C.ARMED | C.LINK_LOST, about=C.OWN_LOST),
    Rule(C.WAS_EXTERNAL, Phase.ABORT, MODE_CHANGED, unless=C.EXTERNAL | C.LINK_LOST, about=C.OWN_LOST),
    Rule(C.COMMAND_FAILED, Phase.ABORT, "the vehicle refused a command"),
    Rule(C.NOT_FOLLOWING, Phase.ABORT, "vehicle does not follow its velocity set-points"),
    Rule(C.NO_RESULT, Phase.ABORT, FILTER_FAILED),
)
_TIRED = Rule(C.TIRED, Phase.ABORT, "the battery is too low to land on the target")
_CUT_OFF = Rule(C.CUT_OFF, Phase.ABORT, "too few fleet members send messages")
_INPUTS = (
    Rule(C.OWN_LOST, Phase.HOLD, "own state lost"),
    Rule(C.LINK_LOST, Phase.HOLD, "heartbeat lost"),
    Rule(C.TARGET_LOST, Phase.HOLD, "target lost"),
)
_CHECK = Rule(C.CHECK_FAILED, Phase.ABORT, "a check of the landing failed")
START_LATE = Rule(C.PHASE_TIME_OVER, Phase.ABORT, "start not reached in time")
_NOT_OFF = C.ARMED | C.LINK_LOST
_STANDS = C.COMMAND_FAILED | C.STANDING
_ASKED = C.EMERGENCY | C.ABORT_ASKED
# abort rules that do not apply to a vehicle that has flown clear of the target and lands beside it
_UNLESS_CLEAR = tuple(
    replace(rule, to=Phase.ABORT, unless=rule.unless | C.CLEAR)
    for rule in (*_IN_FLIGHT[len(_OPERATOR) :], *_INPUTS)
)

TABLE: dict[Phase, tuple[Rule[Phase], ...]] = {
    Phase.WAIT: (
        *_OPERATOR,
        Rule(C.COMMAND_FAILED, Phase.ABORT, "the vehicle refused a command"),
        Rule(C.PHASE_TIME_OVER, Phase.ABORT, "inputs did not become ready in time", about=_TO_BEGIN),
        Rule(C.TIRED | C.EXTERNAL, Phase.ABORT, _TIRED.reason, unless=C.STANDING),
        Rule(C.READY | C.EXTERNAL, Phase.APPROACH, "flying and all inputs fresh", unless=C.STANDING),
        Rule(C.READY | C.RECOVERED | C.STANDING, Phase.TAKEOFF, "all inputs fresh"),
    ),
    Phase.TAKEOFF: (
        *_IN_FLIGHT,
        *_INPUTS,
        _TIRED,
        _CUT_OFF,
        _CHECK,
        START_LATE,
        Rule(C.AT_START | C.EXTERNAL, Phase.APPROACH, "start reached"),
    ),
    Phase.APPROACH: (
        *_IN_FLIGHT,
        *_INPUTS,
        _TIRED,
        _CUT_OFF,
        Rule(C.LANDING_TIME_OVER, Phase.ABORT, "landing took too long"),
        _CHECK,
        Rule(C.OVER_PAD, Phase.LAND, "inside the descending cone"),
    ),
    Phase.LAND: (
        *_IN_FLIGHT,
        *_INPUTS,
        Rule(C.LANDING_TIME_OVER, Phase.ABORT, "landing took too long"),
        Rule(C.TOUCH, Phase.TOUCHDOWN, "touchdown rule met"),
        _CHECK,
        Rule(NONE, Phase.APPROACH, "left the descending cone", unless=C.OVER_PAD),
    ),
    Phase.TOUCHDOWN: (
        *_OPERATOR,
        Rule(C.WAS_ARMED, Phase.LANDED, "motors off", unless=C.ARMED | C.LINK_LOST),
        Rule(C.OWN_LOST, Phase.ABORT, "own state lost at touchdown"),
        Rule(C.NOT_FOLLOWING, Phase.ABORT, "vehicle does not follow its velocity set-points"),
        _CHECK,
        Rule(C.DRIFTED | C.RETRIES_LEFT, Phase.APPROACH, "going to miss the pad: go around"),
        Rule(C.DRIFTED, Phase.ABORT, "going to miss the pad, and no retry left"),
        Rule(C.SET_OFF | C.RETRIES_LEFT, Phase.APPROACH, "the target has become too fast: go around"),
        Rule(C.SET_OFF, Phase.ABORT, "the target has become too fast, and the battery allows no go-around"),
        Rule(C.PHASE_TIME_OVER, Phase.ABORT, "no contact, or motors did not stop"),
    ),
    Phase.LANDED: (
        Rule(C.PAD_WANTED, Phase.LEAVE, "another vehicle waits for this pad", unless=_ASKED),
    ),
    Phase.LEAVE: (
        *_OPERATOR,
        Rule(C.WAS_ARMED | C.CLEAR, Phase.LANDED, "motors off beside the target", unless=_NOT_OFF),
        Rule(_STANDS, Phase.LANDED, "no further take-off: remains on the pad", unless=C.ARMED),
        *_UNLESS_CLEAR,
        Rule(C.PHASE_TIME_OVER, Phase.ABORT, "the pad was not left in time"),
    ),
    Phase.HOLD: (
        *_IN_FLIGHT,
        _CUT_OFF,
        Rule(C.RECOVERED | C.STARTED | C.RETRIES_LEFT, Phase.APPROACH, "inputs good again"),
        Rule(C.RECOVERED | C.RETRIES_LEFT, Phase.TAKEOFF, "inputs good again"),
        Rule(C.PHASE_TIME_OVER | C.OWN_LOST, Phase.ABORT, "own state stayed lost"),
        Rule(C.PHASE_TIME_OVER | C.LINK_LOST, Phase.ABORT, "heartbeat stayed lost"),
        Rule(C.TIRED, Phase.ABORT, _TIRED.reason, unless=C.OWN_LOST | C.LINK_LOST),
        Rule(C.PHASE_TIME_OVER, Phase.CLIMB, "target stayed lost", about=C.TARGET_LOST),
    ),
    Phase.CLIMB: (
        *_IN_FLIGHT,
        Rule(C.OWN_LOST, Phase.ABORT, "own state lost in the climb"),
        Rule(C.LINK_LOST, Phase.ABORT, "heartbeat lost in the climb"),
        _TIRED,
        _CUT_OFF,
        Rule(C.RECOVERED | C.STARTED | C.RETRIES_LEFT | C.HIGH_ENOUGH, Phase.APPROACH, "target back"),
        Rule(C.RECOVERED | C.RETRIES_LEFT | C.HIGH_ENOUGH, Phase.TAKEOFF, "target back", unless=C.STARTED),
        Rule(C.PHASE_TIME_OVER, Phase.ABORT, "target did not come back", about=C.TARGET_LOST),
    ),
    Phase.ABORT: (),
}  # fmt: skip


_STOP = Rule(C.EMERGENCY, AbortWay.MOTORS_OFF, "emergency stop")
_GROUNDS_TO_LAND = (
    Rule(C.LAND_ASKED, AbortWay.LAND_HERE, "ended by the operator"),
    Rule(C.OWN_LOST, AbortWay.LAND_HERE, "no vehicle state"),
    Rule(C.LINK_LOST, AbortWay.LAND_HERE, "the heartbeat is lost"),
    Rule(C.COMMAND_FAILED, AbortWay.LAND_HERE, "the vehicle refused a command"),
    Rule(C.NOT_FOLLOWING, AbortWay.LAND_HERE, "vehicle does not follow its velocity set-points"),
    Rule(NONE, AbortWay.LAND_HERE, "the target was never seen", unless=C.TARGET_KNOWN),
    Rule(C.ON_PAD, AbortWay.LAND_HERE, "it has touched the pad"),
    Rule(C.CUT_OFF, AbortWay.LAND_HERE, "neighbours assume a landing near the last announced position"),
)

ABORT_TABLE: dict[AbortWay, tuple[Rule[AbortWay], ...]] = {
    AbortWay.NONE: (
        _STOP,
        Rule(NONE, AbortWay.HANDS_OFF, "it never flew", unless=C.WAS_ARMED),
        Rule(C.STANDING, AbortWay.HANDS_OFF, "on the ground with motors off", unless=C.ARMED),
        Rule(NONE, AbortWay.LAND_HERE, "contradiction: disarmed in the air", unless=C.ARMED),
        Rule(C.STANDING, AbortWay.LAND_HERE, "never climb away when landed"),
        Rule(C.WAS_EXTERNAL, AbortWay.HANDS_OFF, "mode changed", unless=C.EXTERNAL | C.LINK_LOST),
        *_GROUNDS_TO_LAND,
        Rule(NONE, AbortWay.FLY_CLEAR, "in flight with a known target position"),
    ),
    AbortWay.MOTORS_OFF: (),
    AbortWay.HANDS_OFF: (_STOP,),
    AbortWay.LAND_HERE: (_STOP,),
    AbortWay.FLY_CLEAR: (_STOP, _GROUNDS_TO_LAND[0]),
}


def first(rules: tuple[Rule[To], ...], conditions: int) -> Rule[To] | None:
    """Return the first rule whose conditions hold; None: phase and kind of abort remain."""
    for rule in rules:
        if conditions & rule.when == rule.when and not conditions & rule.unless:
            return rule
    return None
