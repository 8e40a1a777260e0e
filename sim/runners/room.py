"""Interactions between the vehicles of a room: jets, collisions, distances and messages.

Each call of ``Air.blow`` updates the rotor jets, which stay constant until the next call. A vehicle's motion
therefore acts on other vehicles one tick later. Jets have no transport delay, and wind does not move them.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, TypeVar

import numpy as np

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, PAIR, Silence
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Cell
from flightstack.core.controller import Outputs
from flightstack.core.types import MemberStatus
from flightstack.onboard.lockstep import HEARD, OVER, TOLD, joined
from logs.recorder.feed import Feed
from logs.schema.events import Severity
from logs.schema.rows import FleetPairRow
from logs.schema.schemas import FLEET_PAIR
from sim.chance import member as seed_of
from sim.chance import stream
from sim.clock import NS_PER_S, STARTUP_S, NoAnswerError, TickGrid, wait_until
from sim.plant.air import JET, feel, set_jet
from sim.plant.states import rotation_axes
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.judge import Shape, Team, overlapping
from sim.vehicle.physics import Physics, VehicleRecord
from sim.vehicle.vehicle import VehicleSim
from sim.vehicle.vehicle import warm_up as warm_up_vehicle


@jitted
def _blow(vehicle: Cell[VehicleRecord], jet: F64) -> None:
    v = vehicle[0]
    body = v.world.body
    set_jet(v.downwash, v.rotors.thrust_n, body.position, rotation_axes(body.quaternion), jet)


@jitted
def _feel(vehicle: Cell[VehicleRecord], jets: F64, own: int) -> None:
    v = vehicle[0]
    body = v.world.body
    feel(v.downwash, jets, own, body.position, rotation_axes(body.quaternion))


class Air:
    """Air flow between the vehicles of a team."""

    def __init__(self, team: Sequence[Physics]) -> None:
        self._team = tuple(team)
        # (N, JET) jets of the vehicles at the last call of ``blow``
        self.jets = np.zeros((len(self._team), JET))

    def blow(self) -> None:
        """Apply to each vehicle the current jets of all other vehicles, until the next call."""
        if len(self._team) < 2:
            return
        for number, each in enumerate(self._team):
            _blow(each.vehicle, self.jets[number])
        for number, each in enumerate(self._team):
            _feel(each.vehicle, self.jets, number)


T = TypeVar("T")

TOPIC = "/fleet/pairs"
NEVER = -1  # value in FleetPair.msg if there was no collision
_LOG_HZ = 10
_MS_PER_S = 1000.0
_BLOCK = 256  # count of random numbers in one draw
_YIELDS = 20  # number of polls without a pause; the message usually arrives during these polls
_PAUSE_S = 50e-6  # time between later polls, s
_MATCH_PAUSE_S = 0.002  # time between two checks for subscribers, s


@dataclass(slots=True)
class Pair:
    """Smallest distances of two members."""

    one: int  # number of the first vehicle, from 1
    other: int  # number of the second vehicle, always higher
    distance_min_m: float = math.inf  # smallest distance of the centres of mass
    flying_distance_min_m: float = math.inf  # smallest distance while both flew; infinite: never both
    # smallest ellipsoid norm of the relative position while both flew; below 1: inside
    ellipsoid_min: float = math.inf
    violations: int = 0  # number of entries into the ellipsoid of a neighbour
    inside_ms: int = 0  # total duration of the ticks inside the ellipsoid
    collided_ms: int | None = None  # time of the first overlap of the shapes; None: no overlap


class Room:
    """Connects the vehicles tick by tick: call ``begin``, simulate the tick of each vehicle, call ``end``.

    Vehicles act on each other with a delay of one tick. The propellers of colliding vehicles break at the end
    of the tick of the collision.

    Raises ValueError: two vehicles overlap at the start.
    """

    def __init__(self, members: Sequence[VehicleNode], grid: TickGrid, feed: Feed) -> None:
        self._members, self._grid, self._feed = members, grid, feed
        self._air = Air([member.vehicle.physics for member in members])
        shapes = [Shape.of(member.vehicle.physics.params) for member in members]
        # all pairs, (1, 2) first; ``found`` fills in their smallest distances
        self._pairs = [Pair(i, j) for i, j in combinations(range(1, len(members) + 1), 2)]
        self._team, self._inside = Team(shapes), [False] * len(self._pairs)
        self._before, self._flew = self._states(), self._flying()
        # a single vehicle has no pair, and needs no compiled code for pairs
        for one, other in overlapping(shapes, self._before[:, :3]) if self._pairs else ():
            place = ", ".join(f"{each:.2f}" for each in members[one].vehicle.body()[:3])
            raise ValueError(
                f"{members[one].name} and {members[other].name} begin inside each other, at ({place}) m; "
                "give them other start places"
            )
        self._channel = feed.channel(TOPIC, FLEET_PAIR) if self._pairs else 0
        self._every, self._written = max(1, round(grid.rate_hz / _LOG_HZ)), 0

    def begin(self) -> None:
        """Update the jets before a tick."""
        self._air.blow()

    def end(self, tick: int, epoch_ns: int) -> None:
        """Evaluate a tick that all vehicles have flown; write the distances about ten times per second.

        ``tick``: number of the tick; ``epoch_ns``: Unix time of tick 0.
        """
        if not self._pairs:
            return
        grid, before, flew = self._grid, self._before, self._flew
        begin_ms, steps = grid.ms(tick), grid.ms(tick + 1) - grid.ms(tick)
        self._before, self._flew = self._states(), self._flying()
        if self._team.follow(before, self._before, flew & self._flew, steps):
            self._note(begin_ms, steps)
        else:
            self._inside = [False] * len(self._pairs)
        if (tick + 1) % self._every == 0:
            self.write(tick, epoch_ns)

    def found(self) -> tuple[Pair, ...]:
        """Return all pairs with their smallest distances."""
        for pair, least in zip(self._pairs, self._team.least.tolist(), strict=True):
            pair.distance_min_m, pair.flying_distance_min_m, pair.ellipsoid_min = least
        return tuple(self._pairs)

    def write(self, tick: int, epoch_ns: int) -> None:
        """Write the smallest distances of all pairs up to the end of a tick; arguments as in ``end``."""
        stamp_ns, members = epoch_ns + self._grid.ns(tick + 1), self._members
        for pair in self.found():
            self._written += 1
            collided_ms = NEVER if pair.collided_ms is None else pair.collided_ms
            row = FleetPairRow(
                stamp_ns, members[pair.one - 1].number, members[pair.other - 1].number, pair.distance_min_m,
                pair.flying_distance_min_m, pair.ellipsoid_min, pair.violations, pair.inside_ms, collided_ms,
            )  # fmt: skip
            self._feed.write(self._channel, stamp_ns, stamp_ns, self._written, row.pack())

    def _note(self, begin_ms: int, steps: int) -> None:
        """Count the pairs inside their ellipsoid; the first overlap of a pair is a collision."""
        now, hits = [bool(each) for each in self._team.inside], []
        for pair, inside, was, overlap_ms in zip(
            self._pairs, now, self._inside, self._team.overlap_ms.tolist(), strict=True
        ):
            pair.violations += inside and not was
            pair.inside_ms += steps * inside
            if overlap_ms >= 0 and pair.collided_ms is None:
                pair.collided_ms = begin_ms + overlap_ms
                hits.append((pair.collided_ms, pair))
        self._inside = now
        self._collide(hits)

    def _collide(self, hits: Sequence[tuple[int, Pair]]) -> None:
        for at_ms, pair in hits:
            for own, other in ((pair.one, pair.other), (pair.other, pair.one)):
                text = f"collision with {self._members[other - 1].name}"
                self._members[own - 1].say(at_ms / _MS_PER_S, Severity.ERROR, text)
        for number in {number for _, pair in hits for number in (pair.one, pair.other)}:
            self._members[number - 1].vehicle.collide()

    def _states(self) -> F64:
        """Return position (m) and velocity (m/s) of all vehicles, (N, 6), ENU."""
        return np.array([member.vehicle.body()[:6] for member in self._members])

    def _flying(self) -> I64:
        """Whether each vehicle flies, (N,): motors running, off the ground and off a pad."""
        vehicles = [member.vehicle for member in self._members]
        return np.array(
            [each.motors_running and not (each.on_pad or each.on_ground) for each in vehicles], "i8"
        )


class Words:
    """Transmits fleet messages with the delay and loss of ``Scenario.exchange``.

    A message sent at tick k arrives at tick k + 1 at the earliest. Its loss depends only on the seed, the
    sender and the receiver, so it does not change when members are added.
    """

    def __init__(self, team: Scenario, seed: int) -> None:
        link, rate_hz = team.exchange, team.rate_hz
        silent, apart = frozenset(link.silent), frozenset(link.apart)
        broken_tick = math.ceil(link.broken_from_s * rate_hz - 1e-9)
        self._grid = TickGrid(rate_hz)
        self._ticks = max(1, math.ceil(link.delay_s * rate_hz - 1e-9))
        numbers = range(1, len(team.members) + 1)
        self._ways: list[list[_Way]] = []
        for hearer in numbers:
            broken = {n for n in numbers if n in silent or (n in apart) != (hearer in apart)}
            since = {n: broken_tick if n in broken else math.inf for n in numbers}
            since[hearer] = 0  # no member receives its own messages
            self._ways.append([_Way(seed, n, hearer, link.loss, since[n]) for n in numbers])
        self._under_way: deque[list[list[Any]]] = deque([[] for _ in numbers] for _ in range(self._ticks - 1))

    def __call__(self, tick: int, outputs: Sequence[Outputs | None]) -> list[tuple[MemberStatus, ...]]:
        """Take the outputs of one tick; return the messages that each member receives with the next tick.

        ``outputs``: outputs of all controllers at this tick; None after the end of a flight.
        """
        arrive_s = self._grid.ns(tick + self._ticks) / NS_PER_S
        told = [None if each is None else each.member_status for each in outputs]
        on_time = [word and word._replace(arrival_s=arrive_s) for word in told]
        return [tuple(words) for words in self.pass_on(tick, on_time)]

    def pass_on(self, tick: int, told: Sequence[T | None]) -> list[list[T]]:
        """Take the messages of one tick, in any form; return the messages that each member receives next.

        ``told``: message of each member, or None.
        """
        self._under_way.append(
            [
                [
                    word
                    for word, way in zip(told, ways, strict=True)
                    if not way.loses(tick) and word is not None
                ]
                for ways in self._ways
            ]
        )
        return self._under_way.popleft()


class _Way:
    """Link from one sender to one receiver; it loses random messages, and from a given tick on all."""

    def __init__(self, seed: int, teller: int, hearer: int, loss: float, broken_tick: float) -> None:
        self._loss, self._broken_tick = loss, broken_tick
        self._chance = stream(seed_of(seed, hearer), f"words.{teller}")
        self._drawn: list[float] = []

    def loses(self, tick: int) -> bool:
        """Whether the message of a tick is lost.

        Call it in each tick, so that the random draws do not depend on the messages.
        """
        if self._loss > 0.0 and self._draw() < self._loss:
            return True
        return tick >= self._broken_tick

    def _draw(self) -> float:
        if not self._drawn:
            self._drawn = self._chance.random(_BLOCK).tolist()[::-1]
        return self._drawn.pop()


def warm_up_room(team: Scenario) -> None:
    """Compile the code of the room, or load it from the cache."""
    warm_up_vehicle(team)
    two = [VehicleSim(each, 0).physics for each in team.members[:2]]
    Air(two).blow()
    overlapping([Shape.of(each.params) for each in two], np.zeros((len(two), 3)))


class MemberWords:
    """Transmits the messages of one member without decoding them.

    ``flightstack.onboard.lockstep.LockstepStatuses`` is the other end.
    """

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self.namespace, self.tick = namespace, 0  # namespace of the member; current tick of the vehicles
        self._told = zenoh_link.fifo_subscriber(session, f"{namespace}/{TOLD}")
        self._heard = zenoh_link.blocking_publisher(session, f"{namespace}/{HEARD}")
        self._tick, self._payload = -1, b""
        self._last: int | None = None  # tick after which the member's process ended
        self._silent = False

    @property
    def left(self) -> bool:
        """Whether the onboard process has announced its end before this tick."""
        self._poll()
        return self._last is not None and self._last < self.tick

    def take(self, silence: Silence, stop: Stop) -> bytes | None:
        """Wait for the member's message of this tick and return it; None: no message.

        If a member answers its vehicle but sends no message, the next ticks do not wait for it.

        ``silence``: time in this tick without a message of any member.
        """
        looks = 0
        while not self._told_now() and not self._silent and not stop.is_set:
            if silence.look() > COMPANION_SILENT_S:
                self._silent = True
            looks += 1
            time.sleep(0.0 if looks <= _YIELDS else _PAUSE_S)
        return self._payload if self._tick == self.tick and self._payload else None

    def hear(self, words: list[bytes]) -> None:
        """Send the messages that the member receives with the next tick."""
        self._heard.put(joined(words), attachment=PAIR.pack(self.tick + 1, len(words)))

    def await_listener(self, stop: Stop) -> None:
        """Wait until the member has subscribed, because messages without a subscriber are lost.

        Raises NoAnswerError: time-out.
        """

        def matched() -> bool:
            return zenoh_link.is_matched(self._heard)

        if not wait_until(matched, stop, STARTUP_S, pause_s=_MATCH_PAUSE_S):
            raise NoAnswerError(
                f"nobody subscribed to {self.namespace}/{HEARD} within {STARTUP_S:g} s; is its onboard "
                "process running in lockstep, with a table [fleet], and connected to this process's endpoint?"
            )

    def _told_now(self) -> bool:
        self._poll()
        return self._tick >= self.tick or self._last is not None

    def _poll(self) -> None:
        for sample in zenoh_link.drain(self._told):
            tick, over = PAIR.unpack(sample.attachment.to_bytes())
            if over == OVER:
                self._last = tick
            else:
                self._tick, self._payload = tick, sample.payload.to_bytes()
                self._silent = False
