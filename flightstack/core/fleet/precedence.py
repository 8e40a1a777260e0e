"""Order of landings on one pad, or on pads near each other, agreed by messages without a leader.

A vehicle that starts its landing claims the right of way with a time stamp. The claim is granted when every
member with a conflicting pad has replied (as in Ricart and Agrawala's algorithm). A reply is a message that
the member sent later than claim plus latency, without a claim or with this vehicle in ``yields_to``. The
older claim is first; of equally old claims, that of the lower id. A member yields until the other claim ends.

Clocks can disagree on the order of two claims. If both members then yield, the one with the lower id stops
yielding; if neither yields, the one with the higher id starts. A new claim ends a cycle of waiting members.

A vehicle that frees its pad lands beside the paths of all pads, away from landed vehicles (``place_beside``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from flightstack.core.memory import FleetMemory, Heard
from flightstack.core.parameters.fleet import CIRCLE_LATENCIES, DECIDE_LATENCIES, KEPT_PART, Fleet
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import ZERO, Intent, MemberStatus, Phase, Vec3

CLAIMING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN})
ON_GROUND = frozenset({Intent.STANDING, Intent.DOWN})
GOES = frozenset({Intent.LANDING, Intent.COMMITTED})


class Permissions(NamedTuple):
    """Permissions of a fleet member in one tick, with regard to its neighbours."""

    may_begin: bool = True  # whether every other member sends messages, or is down
    may_land: bool = True  # whether this vehicle has the right of way
    may_touch: bool = True  # whether the other members had enough time to receive the intent COMMITTED
    waited: bool = False  # whether this vehicle has waited too long for the right of way
    text: str = ""  # reason with member ids: no message, no right of way, or a request for the pad
    pad_wanted: bool = False  # whether this vehicle must leave the pad, because another member waits for it
    place_enu_m: Vec3 | None = None  # landing place after this vehicle has left the pad, m
    cut_off: bool = False  # whether this vehicle receives messages from too few members and must land


ALONE = Permissions()


class Pad(NamedTuple):
    """Position and velocity of a vehicle's landing spot."""

    position_enu_m: Vec3  # position of the landing spot, m
    velocity_enu_m_s: Vec3  # velocity of the landing spot, m/s


def nearest_m(pad: Pad, place_enu_m: Vec3, moves_m_s: Vec3, ahead_s: float, since_s: float = 0.0) -> float:
    """Return the smallest horizontal distance between pad and place, m, if both velocities are constant.

    The interval is from ``since_s`` before now to ``ahead_s`` after now.
    """
    (x, y, _), (vx, vy, _) = pad
    x, y, vx, vy = place_enu_m[0] - x, place_enu_m[1] - y, moves_m_s[0] - vx, moves_m_s[1] - vy
    speed2 = vx * vx + vy * vy
    at_s = clip(-(x * vx + y * vy) / speed2, -since_s, ahead_s) if speed2 > 0.0 else 0.0
    return math.hypot(x + at_s * vx, y + at_s * vy)


def decide(
    memory: FleetMemory, slots: Sequence[tuple[int, Heard]], phase: Phase, pad: Pad | None, now_s: float,
    fleet: Fleet,
) -> Permissions:  # fmt: skip
    """Update claim and right of way for one tick, and return the permissions."""
    missing = [n for n, slot in slots if not _present(slot.message, now_s, fleet)]
    cut_off = bool(missing) and _cut_off(slots, now_s, fleet)
    if phase not in CLAIMING:
        memory.claim_s, memory.granted = math.nan, False
        memory.waits_since_s = memory.committed_s = math.inf
        for _, slot in slots:
            slot.yields = False
    if phase not in CLAIMING or pad is None:
        waiting = []
        if phase is Phase.LANDED and pad is not None and fleet.frees_pad and not memory.left:
            waiting = [n for n, slot in slots if _waits_for(slot.message, pad, now_s, fleet)]
        text = _names("pad requested by", waiting) or _names("no message from", missing)
        return Permissions(not missing, False, False, False, text, bool(waiting), cut_off=cut_off)
    if not math.isfinite(memory.claim_s):
        memory.claim_s, memory.waits_since_s = now_s, now_s
    blockers = [n for n, slot in slots if _blocks(memory, slot, pad, now_s, fleet)]
    if not memory.granted and _in_a_circle(memory, slots, now_s, fleet):
        memory.claim_s = now_s
    if phase is not Phase.TOUCHDOWN:  # in a touchdown, no message from a member ends the right of way
        taken = memory.granted and any(slot.yields for _, slot in slots)
        memory.granted = (memory.granted or not blockers) and not taken
        memory.waits_since_s = min(memory.waits_since_s, now_s) if not memory.granted else math.inf
    announced_s = now_s - memory.committed_s
    return Permissions(
        not missing,
        memory.granted,
        announced_s >= fleet.age_max_s + fleet.latency_max_s,
        now_s - memory.waits_since_s > fleet.wait_max_s,
        _names("no right of way because of", blockers),
        cut_off=cut_off,
    )


def _in_a_circle(memory: FleetMemory, slots: Sequence[tuple[int, Heard]], now_s: float, fleet: Fleet) -> bool:
    """Whether this vehicle must make a new claim to break a cycle of members that yield to each other.

    Clocks that disagree can cause a cycle of three members. The highest id makes its new claim first.
    """
    first = [slot.message for _, slot in slots if slot.yields and slot.message is not None]
    if not first or not all(message.yields_to and message.intent not in GOES for message in first):
        return False
    higher = sum(n > fleet.id for n, _ in slots)
    return now_s - memory.claim_s > (1 + higher) * CIRCLE_LATENCIES * fleet.latency_max_s


def is_recent(message: MemberStatus | None, now_s: float, fleet: Fleet) -> bool:
    """Whether the newest message of a member is at most ``fleet.age_max_s`` old."""
    return message is not None and now_s - message.stamp_s <= fleet.age_max_s


def _cut_off(slots: Sequence[tuple[int, Heard]], now_s: float, fleet: Fleet) -> bool:
    """Whether this vehicle is in the part of a divided fleet that has to land.

    If two parts of a fleet do not receive each other's messages, the larger part continues, or of two equal
    parts the one with the lowest id. A silent member that was down, or never sent a message, is not counted.
    """
    recent = [n for n, slot in slots if is_recent(slot.message, now_s, fleet)]
    heard = [(n, slot.message) for n, slot in slots if slot.message is not None]
    lost = [n for n, message in heard if n not in recent and message.intent is not Intent.DOWN]
    ours = [fleet.id, *recent]
    return (len(ours), -min(ours)) < (len(lost), -min(lost, default=0))


def _present(message: MemberStatus | None, now_s: float, fleet: Fleet) -> bool:
    """Whether a member sends messages or is down; a landed member is allowed to stop sending."""
    return message is not None and (message.intent is Intent.DOWN or is_recent(message, now_s, fleet))


def _blocks(memory: FleetMemory, slot: Heard, pad: Pad, now_s: float, fleet: Fleet) -> bool:
    """Whether a member blocks this vehicle's landing; the call also updates whether this vehicle yields."""
    message = slot.message
    if message is None:
        return True
    if message.intent in ON_GROUND:
        slot.yields = False
        near = _distance_m(pad, message) < fleet.radius_xy_m
        # a silent vehicle on a moving pad has left its last reported position
        slot.on_pad = near or (slot.on_pad and now_s - message.stamp_s > fleet.age_max_s)
        if slot.on_pad:
            return True
    elif (
        fleet.frees_pad
        and message.intent is Intent.CLEARING
        and _distance_m(pad, message) < fleet.pad_distance_m
    ):
        slot.yields = slot.on_pad = False
        return True
    if message.intent is not Intent.DOWN and now_s - message.stamp_s > fleet.silent_flight_s:
        slot.yields = False  # the flight of this member has ended, possibly on the same pad
        return _conflict(message, pad, 0.0, fleet)
    ahead_s = fleet.descent_s * (KEPT_PART if memory.granted else 1.0)
    if not (slot.yields and slot.claim_s == message.claim_s) and not _conflict(message, pad, ahead_s, fleet):
        slot.yields = False
        return False
    if message.intent is Intent.DOWN:
        return False
    since_s = message.stamp_s - message.clock_bound_s - memory.claim_s
    answered = since_s >= fleet.latency_max_s and now_s - message.stamp_s <= fleet.age_max_s
    if not math.isfinite(message.claim_s):
        slot.yields = False
        return not answered
    gives_way = answered and fleet.id in message.yields_to
    slot.yields = _yields(memory, slot, message, now_s, fleet, answered=answered, gives_way=gives_way)
    slot.claim_s = message.claim_s
    return slot.yields or not gives_way


def _distance_m(pad: Pad, message: MemberStatus) -> float:
    """Return the horizontal distance between a vehicle and a pad, m."""
    return nearest_m(pad, message.position_enu_m, message.velocity_enu_m_s, 0.0)


def _waits_for(message: MemberStatus | None, pad: Pad, now_s: float, fleet: Fleet) -> bool:
    """Whether a member claims the pad on which this vehicle stands."""
    if message is None or message.pad_position_enu_m is None or now_s - message.stamp_s > fleet.age_max_s:
        return False
    place, moves = message.pad_position_enu_m, message.pad_velocity_enu_m_s or ZERO
    return math.isfinite(message.claim_s) and nearest_m(pad, place, moves, 0.0) < fleet.radius_xy_m


def _yields(
    memory: FleetMemory, slot: Heard, message: MemberStatus, now_s: float, fleet: Fleet, *,
    answered: bool, gives_way: bool,
) -> bool:  # fmt: skip
    goes, lower = message.intent in GOES, fleet.id < message.id
    if memory.granted:  # this vehicle yields only to a member whose older claim was granted, too
        return goes and (message.claim_s, message.id) < (memory.claim_s, fleet.id) and not gives_way
    if lower and gives_way and not goes:
        return False
    if goes or (slot.yields and slot.claim_s == message.claim_s):
        return True
    both_s = max(memory.claim_s, message.claim_s) + DECIDE_LATENCIES * fleet.latency_max_s
    if (message.claim_s, message.id) < (memory.claim_s, fleet.id):
        return True
    return not lower and answered and not gives_way and now_s > both_s


def _conflict(message: MemberStatus, pad: Pad, ahead_s: float, fleet: Fleet) -> bool:
    """Whether two pads are too near to each other for two landings; a claim for an unknown pad conflicts.

    The horizon is shorter for a vehicle with the right of way: pad velocities have errors, and an aborted
    descent costs more time than a delayed one.
    """
    place = message.pad_position_enu_m
    if place is None:
        return math.isfinite(message.claim_s)
    return nearest_m(pad, place, message.pad_velocity_enu_m_s or ZERO, ahead_s) < fleet.pad_distance_m


def _names(what: str, ids: Sequence[int]) -> str:
    if not ids:
        return ""
    return f"{what} member{'s' if len(ids) > 1 else ''} {', '.join(map(str, ids))}"


DIRECTIONS = 16  # number of directions from the pad in which candidate places lie
RINGS = (1.4, 2.0, 2.6)  # distances of the candidate places from the pad, divided by ``wait_distance_m``
APART = 3.0  # required distance from a vehicle on the ground, divided by ``radius_xy_m``
KEPT_M = 0.2  # reduction of the required distances for the place chosen earlier, m


def place_beside(
    kept: Vec3 | None, own_enu_m: Vec3, pad: Pad, messages: Sequence[MemberStatus], fleet: Fleet
) -> Vec3:
    """Return the landing place chosen earlier, or a new one if pads or vehicles come too near to it.

    The path of a pad is straight: from its position ``wait_max_s`` ago to its position in ``wait_max_s``. The
    free place nearest to this vehicle is chosen; if none is free, the one with the most room. A chosen place
    remains as long as it is clear of shorter paths, from ``descent_s`` ago to ``descent_s`` ahead, because
    errors of a pad's velocity rotate the longer path too much.
    """
    pads = [pad]
    for message in messages:
        if message.pad_position_enu_m is not None:
            pads.append(Pad(message.pad_position_enu_m, message.pad_velocity_enu_m_s or ZERO))
    grounded = [message.position_enu_m for message in messages if message.intent in ON_GROUND]

    def room_m(place: Vec3, ahead_s: float) -> float:
        least_m = min(nearest_m(each, place, ZERO, ahead_s, ahead_s) for each in pads) - fleet.wait_distance_m
        for x, y, _ in grounded:
            least_m = min(least_m, math.hypot(x - place[0], y - place[1]) - APART * fleet.radius_xy_m)
        return least_m

    if kept is not None and room_m(kept, fleet.descent_s) >= -KEPT_M:
        return kept
    (x, y, _), found = pad.position_enu_m, []
    for ring in RINGS:
        for number in range(DIRECTIONS):
            d_m, angle = ring * fleet.wait_distance_m, number * math.tau / DIRECTIONS
            place = (x + d_m * math.cos(angle), y + d_m * math.sin(angle), 0.0)
            away_m = math.hypot(place[0] - own_enu_m[0], place[1] - own_enu_m[1])
            found.append((min(room_m(place, fleet.wait_max_s), 0.0), -away_m, place))
    return max(found)[2]
