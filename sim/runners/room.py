"""Interactions between the vehicles of a room: jets, collisions, distances and messages.

Each call of ``blow`` updates the rotor jets, which stay constant until the next call. A vehicle's motion
therefore acts on other vehicles one tick later. Jets have no transport delay, and wind does not move them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import combinations, islice
from typing import Any, TypeVar

import numpy as np
from msgspec import msgpack

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, wait_until
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64, Cell
from flightstack.onboard.lockstep import HEARD, TOLD
from logs.recorder.feed import Feed
from logs.schema.events import Severity
from logs.schema.rows import FleetPairRow
from logs.schema.schemas import FLEET_PAIR
from sim.chance import member as seed_of
from sim.chance import stream
from sim.clock import TickGrid, await_subscriber
from sim.plant.air import JET, feel, set_jet
from sim.plant.sensors import NS_PER_MS
from sim.plant.states import rotation_axes
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.judge import Shape, Team, overlapping
from sim.vehicle.physics import VehicleRecord
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


def blow(team: Sequence[VehicleSim], jets: F64) -> None:
    """Apply to each vehicle the current jets (N, JET) of all other vehicles, until the next call."""
    for number, each in enumerate(team):
        _blow(each.cell, jets[number])
    for number, each in enumerate(team):
        _feel(each.cell, jets, number)


T = TypeVar("T")
TOPIC = "/fleet/pairs"
NEVER = -1  # value in FleetPair.msg if there was no collision
_LOG_HZ = 10


class Room:
    """Connects the vehicles tick by tick: call ``begin``, simulate the tick of each vehicle, call ``end``.

    Vehicles act on each other with a delay of one tick. The propellers of colliding vehicles break at the end
    of the tick of the collision.

    Raises ValueError: two vehicles overlap at the start.
    """

    def __init__(self, members: Sequence[VehicleNode], grid: TickGrid, feed: Feed) -> None:
        self._grid, self._feed = grid, feed
        self._pairs = list(combinations(members, 2))  # (1, 2) first
        # vehicles that can meet another vehicle, in the order of the members. If there are none, no jet is
        # computed in each tick (saves 6 us), and its code is not compiled (saves 1.6 s).
        self._vehicles = list(dict.fromkeys(each.vehicle for pair in self._pairs for each in pair))
        self._jets = np.zeros((len(self._vehicles), JET))
        shapes = [Shape.of(each.params) for each in self._vehicles]
        self._team = Team(shapes)
        number = len(self._pairs)
        # for each pair: time of collision; number and duration of stays in the ellipsoid; whether inside now
        self._collided_ms = np.full(number, NEVER)
        self._violations, self._inside_ms = np.zeros(number, np.int64), np.zeros(number, np.int64)
        self._inside = np.zeros(number, np.bool_)
        self._before, self._flew = self._states(), self._flying()
        for one, other in overlapping(shapes, self._before[:, :3]):
            place = ", ".join(f"{each:.2f}" for each in members[one].vehicle.body().position_enu_m)
            raise ValueError(
                f"{members[one].name} and {members[other].name} begin inside each other, at ({place}) m; "
                "give them other start places"
            )
        self._channels = [feed.channel(TOPIC, FLEET_PAIR) for _ in self._pairs]
        self._every, self._written = max(1, round(grid.rate_hz / _LOG_HZ)), 0

    def begin(self) -> None:
        """Update the jets before a tick."""
        blow(self._vehicles, self._jets)

    def end(self, tick: int, epoch_ns: int) -> None:
        """Evaluate a tick that all vehicles have flown; write the distances about ten times per second.

        ``tick``: number of the tick; ``epoch_ns``: Unix time of tick 0.
        """
        if not self._pairs:  # saves 13 us a tick
            return
        grid, before, flew = self._grid, self._before, self._flew
        begin_ms, steps = grid.ms(tick), grid.ms(tick + 1) - grid.ms(tick)
        self._before, self._flew = self._states(), self._flying()
        if self._team.follow(before, self._before, flew & self._flew, steps):
            self._note(begin_ms, steps)
        else:
            self._inside[:] = False
        if (tick + 1) % self._every == 0:
            self.write(tick, epoch_ns)

    def found(self, stamp_ns: int = 0) -> tuple[FleetPairRow, ...]:
        """Return all pairs with their smallest distances until the time of ``stamp_ns``."""
        counts = np.stack((self._violations, self._inside_ms, self._collided_ms), axis=1).tolist()
        return tuple(
            FleetPairRow(stamp_ns, one.number, other.number, *least, *numbers)
            for (one, other), least, numbers in zip(
                self._pairs, self._team.least.tolist(), counts, strict=True
            )
        )

    def write(self, tick: int, epoch_ns: int) -> None:
        """Write the smallest distances of all pairs up to the end of a tick; arguments as in ``end``."""
        stamp_ns = epoch_ns + self._grid.ns(tick + 1)
        for channel, row in zip(self._channels, self.found(stamp_ns), strict=True):
            self._written += 1
            self._feed.write(channel, stamp_ns, stamp_ns, self._written, row.pack())

    def _note(self, begin_ms: int, steps: int) -> None:
        """Count the pairs inside their ellipsoid; the first overlap of a pair is a collision."""
        inside, overlap_ms = self._team.inside.astype(np.bool_), self._team.overlap_ms
        self._violations += inside & ~self._inside
        self._inside_ms += steps * inside
        self._inside = inside
        hit = np.flatnonzero((overlap_ms >= 0) & (self._collided_ms == NEVER)).tolist()
        self._collided_ms[hit] = begin_ms + overlap_ms[hit]
        for k in hit:
            for one, other in (self._pairs[k], self._pairs[k][::-1]):
                one.say(int(self._collided_ms[k]) * NS_PER_MS, Severity.ERROR, f"collision with {other.name}")
        for node in (node for k in hit for node in self._pairs[k]):
            node.vehicle.collide()

    def _states(self) -> F64:
        """Return position (m) and velocity (m/s) of all vehicles, (N, 6), ENU."""
        return np.array([np.concatenate(each.body()[:2]) for each in self._vehicles]).reshape(-1, 6)

    def _flying(self) -> I64:
        """Whether each vehicle flies, (N,): motors running, off the ground and off a pad."""
        flies = [each.motors_running and not (each.on_pad or each.on_ground) for each in self._vehicles]
        return np.array(flies, "i8")


class Words:
    """Transmits fleet messages with the delay and loss of ``Scenario.exchange``.

    A message sent at tick k arrives at tick k + 1 at the earliest. Losses depend only on seed, sender and
    receiver, so an additional member does not change the losses of the others.
    """

    def __init__(self, team: Scenario, seed: int) -> None:
        link, numbers = team.exchange, range(1, len(team.members) + 1)
        ticks = max(1, math.ceil(link.delay_s * team.rate_hz - 1e-9))
        self._loss = link.loss
        # random streams: one for each receiver and sender
        self._chances = [[stream(seed_of(seed, n), f"words.{m}") for m in numbers] for n in numbers]
        self._under_way: deque[list[list[Any]]] = deque([[] for _ in numbers] for _ in range(ticks - 1))

    def __call__(self, tick: int, told: Sequence[T | None]) -> list[list[T]]:
        """Take the messages of one tick, in any form; return the messages that each member receives next.

        ``told``: message of each member, or None.
        """
        del tick
        found: list[list[T]] = []
        for receiver, chances in enumerate(self._chances):
            # drawn in each tick, so that the random numbers do not depend on the messages
            lost = [self._loss > 0.0 and chance.random() < self._loss for chance in chances]
            lost[receiver] = True  # no member receives its own messages
            found.append(
                [word for word, loses in zip(told, lost, strict=True) if word is not None and not loses]
            )
        self._under_way.append(found)
        return self._under_way.popleft()


def warm_up_room(team: Scenario) -> None:
    """Compile the code of the room, or load it from the cache."""
    warm_up_vehicle(team)
    for pair in islice(combinations(team.members, 2), 1):  # the code is the same for all pairs
        two = [VehicleSim(each, 0) for each in pair]
        blow(two, np.zeros((2, JET)))
        overlapping([Shape.of(each.params) for each in two], np.zeros((2, 3)))


class FleetEnd:
    """The simulator's end of a companion's fleet messages; this class serves a companion without a fleet."""

    tick = 0  # current tick of the vehicles

    def await_listener(self, stop: Stop) -> None:
        """Wait until the member has subscribed, because messages without a subscriber are lost.

        Raises NoAnswerError: time-out.
        """

    @property
    def left(self) -> bool:
        """Whether the companion has announced its end before this tick."""
        return False

    def take(self, stop: Stop) -> Any:
        """Return the companion's message of this tick, or None."""

    def hear(self, words: Any) -> None:
        """Send the messages that the companion receives with the next tick."""


class MemberWords(FleetEnd):
    """Transmits the messages of one member without decoding them.

    ``flightstack.onboard.lockstep.LockstepStatuses`` is the other end.
    """

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self.namespace, self.tick = namespace, 0  # namespace of the member; current tick of the vehicles
        self._told = zenoh_link.fifo_subscriber(session, f"{namespace}/{TOLD}")
        self._heard = zenoh_link.blocking_publisher(session, f"{namespace}/{HEARD}")
        self._tick, self._payload = -1, b""
        self._last: int | None = None  # last tick of the member's process; None: the process still runs
        self._silent = False

    @property
    def left(self) -> bool:
        self._poll()
        return self._last is not None and self._last < self.tick

    def take(self, stop: Stop) -> bytes | None:
        """Wait for the member's message of this tick and return it; None: no message.

        If no message arrives in time, later ticks do not wait until the onboard process sends again.
        """
        waits = COMPANION_SILENT_S if not self._silent else 0.0
        self._silent = not wait_until(self._told_now, lambda: stop.is_set, waits)
        return self._payload if self._tick == self.tick and self._payload else None

    def hear(self, words: list[bytes]) -> None:
        self._heard.put(msgpack.encode((self.tick + 1, words)))

    def await_listener(self, stop: Stop) -> None:
        await_subscriber(lambda: zenoh_link.is_matched(self._heard), f"{self.namespace}/{HEARD}", stop)

    def _told_now(self) -> bool:
        self._poll()
        return self._tick >= self.tick or self._last is not None

    def _poll(self) -> None:
        for sample in zenoh_link.drain(self._told):
            tick, over, payload = msgpack.decode(sample.payload.to_bytes(), type=tuple[int, bool, bytes])
            if over:
                self._last = tick
            else:
                self._tick, self._payload, self._silent = tick, payload, False
