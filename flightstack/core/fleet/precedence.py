"""Order of landings on equal pads or on pads that come near each other, by messages without a leader.

A vehicle that starts its landing claims the right of way with a time stamp. It has it when every member whose
pad is in conflict has sent a message since (claim and latency), and has no claim or yields: so the reply of
Ricart and Agrawala is the field ``yields_to``. The older claim is first, then the lower id. A member yields
until the other's claim ends. Clocks may disagree on two claims of the same moment: if both yield, the lower
id stops yielding; if none does, the higher id yields. A cycle of three or more is opened by a new claim.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.memory import FleetMemory, Heard
from flightstack.core.parameters.fleet import CIRCLE_LATENCIES, DECIDE_LATENCIES, KEPT_PART, Fleet
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import ZERO, Intent, Neighbour, Phase, Vec3

CLAIMING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN})
ON_GROUND = frozenset({Intent.STANDING, Intent.DOWN})
GOES = frozenset({Intent.LANDING, Intent.COMMITTED})


class Way(NamedTuple):
    """Permissions of the mission with respect to the neighbours."""

    may_begin: bool = True  # every member has been heard
    may_land: bool = True  # it has the right of way
    may_touch: bool = True  # the announcement that it no longer gives way has reached all neighbours
    waited: bool = False  # it has waited for its right of way for too long
    text: str = ""  # vehicles that it waits for
    pad_wanted: bool = False  # landed on a pad that others wait for, it is to leave it
    place_enu_m: Vec3 | None = None  # place where it lands after that
    cut_off: bool = False  # it hears too few of the others to go on


ALONE = Way()


class Pad(NamedTuple):
    """Landing place of a vehicle."""

    position_enu_m: Vec3  # landing spot
    velocity_enu_m_s: Vec3  # its velocity


def nearest_m(pad: Pad, place_enu_m: Vec3, moves_m_s: Vec3, ahead_s: float) -> float:
    """Least horizontal distance of a pad and a place within a time at constant velocities."""
    (x, y, _), (vx, vy, _) = pad
    x, y, vx, vy = place_enu_m[0] - x, place_enu_m[1] - y, moves_m_s[0] - vx, moves_m_s[1] - vy
    speed2 = vx * vx + vy * vy
    at_s = clip(-(x * vx + y * vy) / speed2, 0.0, ahead_s) if speed2 > 0.0 else 0.0
    return math.hypot(x + at_s * vx, y + at_s * vy)


def decide(
    memory: FleetMemory, slots: Sequence[tuple[int, Heard]], phase: Phase, pad: Pad | None, now_s: float,
    fleet: Fleet,
) -> Way:  # fmt: skip
    """Advance claim and right of way by one tick."""
    missing = [n for n, slot in slots if not _present(slot.word, now_s, fleet)]
    if phase not in CLAIMING or pad is None:
        if phase not in CLAIMING:
            drop(memory, slots)
        text, cut_off = _names("not heard", missing), bool(missing) and _cut_off(slots, now_s, fleet)
        if phase is Phase.LANDED and pad is not None and fleet.frees_pad and not memory.left:
            waiting = [n for n, slot in slots if _waits_for(slot.word, pad, now_s, fleet)]
            return Way(not missing, False, False, False, _names("waits", waiting) or text, bool(waiting))
        return Way(not missing, False, False, False, text, cut_off=cut_off)
    if not math.isfinite(memory.claim_s):
        memory.claim_s, memory.waits_since_s = now_s, now_s
    blockers = [n for n, slot in slots if _blocks(memory, slot, pad, now_s, fleet)]
    if not memory.granted and _in_a_circle(memory, slots, now_s, fleet):
        memory.claim_s = now_s
    if phase is not Phase.TOUCHDOWN:  # which is not interrupted
        taken = memory.granted and any(slot.yields for _, slot in slots)
        memory.granted = (memory.granted or not blockers) and not taken
        memory.waits_since_s = min(memory.waits_since_s, now_s) if not memory.granted else math.inf
    told_s = now_s - memory.committed_s
    return Way(
        not missing,
        memory.granted,
        told_s >= fleet.age_max_s + fleet.latency_max_s,
        now_s - memory.waits_since_s > fleet.wait_max_s,
        _names("no right of way because of", blockers),
        cut_off=bool(missing) and _cut_off(slots, now_s, fleet),
    )


def _in_a_circle(memory: FleetMemory, slots: Sequence[tuple[int, Heard]], now_s: float, fleet: Fleet) -> bool:
    """Whether it yields only to members that yield themselves, for longer than those with higher ids.

    Clocks that disagree can form a cycle of three. A new claim, the youngest of all, opens it.
    """
    first = [slot.word for _, slot in slots if slot.yields and slot.word is not None]
    if not first or not all(word.yields_to and word.intent not in GOES for word in first):
        return False
    higher = sum(n > fleet.id for n, _ in slots)
    return now_s - memory.claim_s > (1 + higher) * CIRCLE_LATENCIES * fleet.latency_max_s


def drop(memory: FleetMemory, slots: Sequence[tuple[int, Heard]]) -> None:
    """Give up claim and right of way; yields to no member."""
    memory.claim_s, memory.granted = math.nan, False
    memory.waits_since_s = memory.committed_s = math.inf
    for _, slot in slots:
        slot.yields = False


def heard(word: Neighbour | None, now_s: float, fleet: Fleet) -> bool:
    """Whether a member's newest message is fresh."""
    return word is not None and now_s - word.stamp_s <= fleet.age_max_s


def _cut_off(slots: Sequence[tuple[int, Heard]], now_s: float, fleet: Fleet) -> bool:
    """Whether this vehicle is in the part of a divided fleet that has to land.

    If two parts of a fleet do not receive each other's messages, the larger part continues; of two equal
    parts the one with the lowest id. Members that are down or never sent a message do not count.
    """
    hears = [n for n, slot in slots if heard(slot.word, now_s, fleet)]
    lost = [n for n, slot in slots if n not in hears and slot.word is not None and not _is_down(slot.word)]
    ours = [fleet.id, *hears]
    return (len(ours), -min(ours)) < (len(lost), -min(lost, default=0))


def _is_down(word: Neighbour | None) -> bool:
    return word is not None and word.intent is Intent.DOWN


def _present(word: Neighbour | None, now_s: float, fleet: Fleet) -> bool:
    """Whether a member sends messages, or is down (a landed member may stop sending)."""
    return word is not None and (word.intent is Intent.DOWN or now_s - word.stamp_s <= fleet.age_max_s)


def _blocks(memory: FleetMemory, slot: Heard, pad: Pad, now_s: float, fleet: Fleet) -> bool:
    """Whether a member blocks the landing of this vehicle; updates whether this vehicle yields to it."""
    word = slot.word
    if word is None:
        return True
    if word.intent in ON_GROUND:
        slot.yields = False
        near = _distance_m(pad, word) < fleet.radius_xy_m
        # a silent vehicle on a moving pad is not at its last position
        slot.on_pad = near or (slot.on_pad and now_s - word.stamp_s > fleet.age_max_s)
        if slot.on_pad:
            return True
    elif fleet.frees_pad and word.intent is Intent.CLEARING and _distance_m(pad, word) < fleet.pad_distance_m:
        slot.yields = slot.on_pad = False
        return True
    if word.intent is not Intent.DOWN and now_s - word.stamp_s > fleet.silent_flight_s:
        slot.yields = False  # its flight has ended; with the same pad it may stand there
        return _conflict(word, pad, 0.0, fleet)
    ahead_s = fleet.descent_s * (KEPT_PART if memory.granted else 1.0)
    if not (slot.yields and slot.claim_s == word.claim_s) and not _conflict(word, pad, ahead_s, fleet):
        slot.yields = False
        return False
    if word.intent is Intent.DOWN:
        return False
    since_s = word.stamp_s - word.clock_bound_s - memory.claim_s
    answered = since_s >= fleet.latency_max_s and now_s - word.stamp_s <= fleet.age_max_s
    if not math.isfinite(word.claim_s):
        slot.yields = False
        return not answered
    gives_way = answered and fleet.id in word.yields_to
    slot.yields = _yields(memory, slot, word, now_s, fleet, answered=answered, gives_way=gives_way)
    slot.claim_s = word.claim_s
    return slot.yields or not gives_way


def _distance_m(pad: Pad, word: Neighbour) -> float:
    """Horizontal distance of a vehicle from a pad."""
    return nearest_m(pad, word.position_enu_m, word.velocity_enu_m_s, 0.0)


def _waits_for(word: Neighbour | None, pad: Pad, now_s: float, fleet: Fleet) -> bool:
    """Whether a member claims the pad on which this vehicle stands."""
    if word is None or word.pad_position_enu_m is None or now_s - word.stamp_s > fleet.age_max_s:
        return False
    place, moves = word.pad_position_enu_m, word.pad_velocity_enu_m_s or ZERO
    return math.isfinite(word.claim_s) and nearest_m(pad, place, moves, 0.0) < fleet.radius_xy_m


def _yields(
    memory: FleetMemory, slot: Heard, word: Neighbour, now_s: float, fleet: Fleet, *,
    answered: bool, gives_way: bool,
) -> bool:  # fmt: skip
    goes, lower = word.intent in GOES, fleet.id < word.id
    if memory.granted:  # revoked only by an older right of way
        return goes and (word.claim_s, word.id) < (memory.claim_s, fleet.id) and not gives_way
    if lower and gives_way and not goes:
        return False
    if goes or (slot.yields and slot.claim_s == word.claim_s):
        return True
    both_s = max(memory.claim_s, word.claim_s) + DECIDE_LATENCIES * fleet.latency_max_s
    if (word.claim_s, word.id) < (memory.claim_s, fleet.id):
        return True
    return not lower and answered and not gives_way and now_s > both_s


def _conflict(word: Neighbour, pad: Pad, ahead_s: float, fleet: Fleet) -> bool:
    """Whether both pads are too near each other for two landings; a claim for an unknown pad always is.

    With the right of way the horizon is shorter: velocities of pads have errors, and an aborted descent costs
    more than a delayed one.
    """
    place = word.pad_position_enu_m
    if place is None:
        return math.isfinite(word.claim_s)
    return nearest_m(pad, place, word.pad_velocity_enu_m_s or ZERO, ahead_s) < fleet.pad_distance_m


def _names(what: str, ids: Sequence[int]) -> str:
    if not ids:
        return ""
    return f"{what} member{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"
