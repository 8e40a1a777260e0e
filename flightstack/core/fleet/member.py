"""This vehicle as a member of a fleet: received messages, constraints by neighbours, sent messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from flightstack.core.fleet.pair import (
    NONE,
    Near,
    barrier,
    estimate,
    faster,
    jump,
    row,
    share,
    sidestep,
    wider,
)
from flightstack.core.fleet.precedence import ALONE, Pad, Permissions, decide, is_recent, place_beside
from flightstack.core.fleet.program import FleetProgram
from flightstack.core.fleet.solution import Row
from flightstack.core.memory import AbortWay, FleetMemory, Heard, Memory
from flightstack.core.parameters.fleet import Fleet
from flightstack.core.safety.position_loop import limit
from flightstack.core.safety.qp_filter import FilterResult
from flightstack.core.target.track import TargetState
from flightstack.core.types import (
    ZERO,
    Inputs,
    Intent,
    Landed,
    MemberStatus,
    OwnState,
    Phase,
    Vec3,
    VehicleStatus,
)

FUTURE_MAX_S = 0.05  # maximum time of a stamp ahead of this clock, in addition to the clock error, s
# ratio of the maximum flight time of another member (wait and landing) to ``fleet.wait_max_s``
FLIGHTS_OF_OTHERS = 2.0
REPORTED_M_S = 0.005  # minimum relaxation of the neighbours' constraints that is reported, m/s
STEADY_S = 1.0  # time without relaxed constraints after which the end of the relaxation is reported, s
HELD_BACK_M_S = 0.3  # maximum speed on each horizontal axis in a silent vehicle's reachable set, m/s
STAYS_S = 5.0  # time after a landing until an event reports that this vehicle blocks a requested pad, s


class Rows(NamedTuple):
    """Neighbours within reach, and one constraint on this vehicle's velocity for each of them."""

    rows: tuple[Row, ...]  # constraints of the program; the nearest neighbour first
    # constraints for the same neighbours, without the reachable sets of neighbours with late messages
    basic: tuple[Row, ...]
    neighbours: tuple[Near, ...]  # data of the neighbours for the side-step, in the order of ``rows``
    # whether the speed is limited because a silent vehicle may be near
    held_back: bool = False


NO_ROWS = Rows((), (), ())


def intent_of(memory: Memory, *, granted: bool, flies: bool) -> Intent:
    """Return the intent that a vehicle in this phase announces to the other members."""
    phase, flies_clear = memory.phase, memory.abort_way is AbortWay.FLY_CLEAR and not memory.clear
    if phase in (Phase.LAND, Phase.TOUCHDOWN):
        return Intent.COMMITTED
    if phase is Phase.LANDED or (phase is Phase.LEAVE and memory.clear):
        return Intent.DOWN
    if phase is Phase.ABORT:
        return Intent.CLEARING if flies_clear else Intent.DOWN
    if (phase in (Phase.WAIT, Phase.LEAVE) and not flies) or (phase is Phase.TAKEOFF and not memory.climbed):
        return Intent.STANDING
    if phase in (Phase.HOLD, Phase.CLIMB, Phase.LEAVE):
        return Intent.CLEARING
    return Intent.LANDING if phase is Phase.APPROACH and granted else Intent.WAITING


class FleetMember:
    """This vehicle in its fleet; ``memory`` is its complete state.

    Without other members a vehicle has every permission, and neither receives nor sends messages.
    """

    memory: FleetMemory

    def __init__(self, fleet: Fleet, sigma_m: float) -> None:
        self.memory = FleetMemory(tuple(Heard() for _ in fleet.others))
        self._fleet, self._sigma_m, self._is_alone = fleet, sigma_m, not fleet.others
        self._index = {n: k for k, n in enumerate(fleet.others)}
        self._program, self._given_m_s = FleetProgram() if fleet.others else None, 0.0

    @property
    def slots(self) -> list[tuple[int, Heard]]:
        """Return the id and the stored state of each other member."""
        return list(zip(self._index, self.memory.slots, strict=True))

    @property
    def _messages(self) -> list[MemberStatus]:
        return [slot.message for slot in self.memory.slots if slot.message is not None]

    def observe(
        self, inputs: Inputs, phase: Phase, target: TargetState | None, now_s: float
    ) -> tuple[list[str], Permissions]:
        """Store the received messages; return event texts and the permissions of this tick."""
        if self._is_alone:
            return [], ALONE
        return self.take(inputs.neighbours, now_s), self.permissions(phase, target, now_s, inputs.own)

    def take(self, messages: Sequence[MemberStatus], now_s: float) -> list[str]:
        """Store the newest message of each member; return event texts for rejections and position jumps."""
        texts = []
        for message in messages:
            why = self._refusal(message, now_s)
            if why:
                texts.append(f"message of vehicle {message.id} refused: {why}")
                continue
            slot = self.memory.slots[self._index[message.id]]
            before = slot.message
            if before is not None:
                if message.stamp_s <= before.stamp_s:
                    continue  # a newer message arrived before this one
                slot.faster_m_s2 = faster(slot.faster_m_s2, before, message)
                by_m = jump(before, message, self._fleet)
                if by_m != ZERO:
                    texts.append(self._jumped(slot, message.id, by_m))
            slot.message = message
        return texts

    def _jumped(self, slot: Heard, who: int, by_m: Vec3) -> str:
        """Record the jump of a member's position; return an event text."""
        (x, y, z), (jx, jy, jz) = slot.jumped_m, by_m
        slot.jumped_m = (x + jx, y + jy, z + jz)
        return (
            f"the position of vehicle {who} jumps by {math.hypot(*by_m):.2f} m: its ellipsoid is larger by "
            f"{math.hypot(*slot.jumped_m):.2f} m now, since either position may be wrong"
        )

    def _refusal(self, message: MemberStatus, now_s: float) -> str:
        if message.id not in self._index:
            return "it is not in fleet.members"
        _, stamp_s, _, p, v, wanted, sigma_m, bound_s, _, claim_s, pad, moves, _ = message
        if not all(map(math.isfinite, (*p, *v, *wanted, stamp_s, sigma_m, bound_s))):
            return "a number is not finite"
        if math.isinf(claim_s) or not all(map(math.isfinite, (*(pad or ZERO), *(moves or ZERO)))):
            return "its claim or its pad is not finite"
        if bound_s < 0.0 or sigma_m < 0.0:
            return "a bound is negative"
        if stamp_s > now_s + bound_s + FUTURE_MAX_S:
            return f"its stamp is {stamp_s - now_s:.2f} s ahead"
        return ""

    def over(self, since_s: float, now_s: float) -> bool:
        """Whether sending can stop: all other members are down or silent, or this phase lasts too long."""
        fleet = self._fleet
        if since_s > FLIGHTS_OF_OTHERS * fleet.wait_max_s:
            return True
        return all(
            each.intent is Intent.DOWN or now_s - each.stamp_s > fleet.silent_flight_s
            for each in self._messages
        )

    def permissions(
        self, phase: Phase, target: TargetState | None, now_s: float, own: OwnState | None = None
    ) -> Permissions:
        """Return the permissions for the mission in this tick.

        The call also updates claim, right of way and landing place; call it once in each tick.
        """
        pad = Pad(target.position_enu_m, target.velocity_enu_m_s) if target is not None else None
        memory, fleet = self.memory, self._fleet
        permissions = decide(memory, self.slots, phase, pad, now_s, fleet)
        if phase is not Phase.LEAVE or pad is None or own is None:
            return permissions
        memory.left = True
        memory.place_enu_m = place_beside(memory.place_enu_m, own.position_enu_m, pad, self._messages, fleet)
        return permissions._replace(place_enu_m=memory.place_enu_m)

    def remains_on_pad(self, permissions: Permissions, in_phase_s: float, why: str) -> list[str]:
        """Return an event text if another vehicle waits for this vehicle's pad; only once in a flight."""
        if not permissions.pad_wanted or self.memory.stays or in_phase_s < STAYS_S:
            return []
        self.memory.stays = True
        return [f"the vehicle remains on the pad: {why or 'an input is lost'}; {permissions.text}"]

    def rows(self, phase: Phase, own: OwnState, wanted_m_s: Vec3, now_s: float) -> Rows:
        """Return the constraints that neighbours within reach put on this vehicle; none in TOUCHDOWN."""
        if phase is Phase.TOUCHDOWN:  # the other vehicles keep clear of a vehicle in its touchdown
            return NO_ROWS
        fleet, (x, y, z), found, held_back = self._fleet, own.position_enu_m, [], False
        reach_m = fleet.reach_m - fleet.radius_xy_m
        for n, slot in self.slots:
            message = slot.message
            if message is None:
                continue
            part = share(slot, message, now_s, fleet)
            if part == NONE:
                continue
            now = estimate(message, now_s, self._sigma_m, fleet, slot.faster_m_s2)
            px, py, pz = now.position_enu_m
            away, late, grown_m = (x - px, y - py, z - pz), now.late, now.grown_m
            if late:
                away, moves = now.beside(own.position_enu_m)
                now = now._replace(velocity_enu_m_s=moves)
            if slot.jumped_m != ZERO:
                grown_m += math.hypot(*slot.jumped_m)
            xy_m, z_m = fleet.radius_xy_m + grown_m, fleet.radius_z_m + grown_m
            h_m, gradient = outer_m, _ = barrier(away, xy_m, z_m, first=fleet.id < n)
            if late:
                more_m = now.anywhere_m - now.grown_m
                outer_m, _ = barrier(away, xy_m + more_m, z_m + more_m, first=fleet.id < n)
            if outer_m > reach_m:
                continue
            if late and outer_m < 0.0:
                held_back |= fleet.age_max_s < now.age_s <= fleet.silent_flight_s
            basic = row(part, h_m, gradient, wanted_m_s, message, now, fleet)
            made = wider(basic, outer_m, now, fleet) if late else basic
            found.append((h_m, n, made, basic, Near(h_m, gradient, away, now.velocity_enu_m_s)))
        if not found:
            return NO_ROWS
        found.sort()  # sorted by h, then by vehicle id
        _, _, rows, basics, near = zip(*found, strict=True)
        return Rows(rows, basics, near, held_back)

    def beside(
        self, phase: Phase, own: OwnState, base: Callable[[Vec3], Vec3], nominal: Vec3, most_m_s: Vec3,
        now_s: float,
    ) -> tuple[Vec3, Rows]:  # fmt: skip
        """Return the nominal velocity with the side-step, and the constraints of the neighbours.

        ``base``: function from the vehicle's velocity to the base of the slew limit; ``most_m_s``: maximum
        velocity on each axis.
        """
        if self._is_alone:
            return nominal, NO_ROWS
        rows = self.rows(phase, own, base(own.velocity_enu_m_s), now_s)
        if not rows.neighbours:
            return nominal, rows
        nominal = limit(nominal, most_m_s)
        if rows.held_back:
            nominal = limit(nominal, (HELD_BACK_M_S, HELD_BACK_M_S, math.inf))
        return sidestep(nominal, rows.neighbours, self._fleet.rate_1_s), rows

    def solve(self, nominal: Vec3, firm: Sequence[Row], rows: Rows, lower: Vec3, upper: Vec3) -> FilterResult:
        """Filter a nominal velocity; the arguments are those of ``FleetProgram.solve``."""
        assert self._program is not None  # a vehicle without other members never calls this method
        found = self._program.solve(nominal, firm, rows.rows, lower, upper, rows.basic)
        self._given_m_s = found.given_m_s
        return found.filter

    def texts(self, permissions: Permissions, in_phase_s: float, why: str, now_s: float) -> list[str]:
        """Return event texts on relaxed constraints and a blocked pad; ``why``: reason against a take-off."""
        if self._is_alone:
            return []
        return self._crowded(now_s) + self.remains_on_pad(permissions, in_phase_s, why)

    def _crowded(self, now_s: float) -> list[str]:
        """Return an event text when the relaxation of the neighbours' constraints starts or ends."""
        memory, given_m_s, self._given_m_s = self.memory, self._given_m_s, 0.0
        if given_m_s > REPORTED_M_S:
            before, memory.crowded, memory.crowded_s = memory.crowded, True, now_s
            text = f"no velocity meets the rows of all neighbours: they are relaxed by {given_m_s:.2f} m/s"
            return [] if before else [text]
        if memory.crowded and now_s - memory.crowded_s > STEADY_S:
            memory.crowded = False
            return ["the rows of the neighbours are no longer relaxed"]
        return []

    def message(
        self, memory: Memory, own: OwnState, status: VehicleStatus | None, base: Callable[[Vec3], Vec3],
        target: TargetState | None, now_s: float,
    ) -> MemberStatus | None:  # fmt: skip
        """Return the message to the other members after this tick; None: there are no other members.

        ``base``: as in ``beside``; its result is the velocity that the message announces.
        """
        if self._is_alone:
            return None
        flies = status is not None and status.armed and status.landed is not Landed.ON_GROUND
        fleet, mine, (x, y, z) = self._fleet, self.memory, own.position_enu_m
        intent = intent_of(memory, granted=mine.granted, flies=flies)
        committed = intent is Intent.COMMITTED
        mine.committed_s = min(mine.committed_s, now_s) if committed else math.inf
        # the position of a silent member is unknown, so this vehicle cannot give way to it
        yields = tuple(n for n, slot in self.slots if slot.yields and is_recent(slot.message, now_s, fleet))
        for n in yields:
            mine.slots[self._index[n]].yielded_s = now_s
        v, late_s = own.velocity_enu_m_s, max(0.0, now_s - own.arrival_s)
        return MemberStatus(
            fleet.id,
            now_s,
            now_s,
            (x + v[0] * late_s, y + v[1] * late_s, z + v[2] * late_s),
            v,
            base(v),
            self._sigma_m,
            0.0,
            intent,
            mine.claim_s,
            target.position_enu_m if target is not None else None,
            target.velocity_enu_m_s if target is not None else None,
            yields,
        )
