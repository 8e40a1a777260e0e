"""What happens between the vehicles of a fleet: jets, collisions, and how near each two come."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from logs.recorder.feed import Feed
from logs.schema.names import member_name
from logs.schema.rows import FleetPairRow
from logs.schema.schemas import FLEET_PAIR
from sim.clock import TickGrid
from sim.runners.fleet.pairs import Pairs
from sim.runners.vehicle_node import VehicleNode
from sim.vehicle.air import Air
from sim.vehicle.vehicle import VehicleSim

TOPIC = "/fleet/pairs"
NEVER = -1  # of FleetPair.msg
_LOG_HZ = 10
_NS_PER_S = 1e9


@dataclass(slots=True)
class Member:
    """One of the vehicles.

    Attributes:
        number: of the vehicle, which is its system id.
        node: the vehicle on its wire.
        over: its flight is over: nothing of it is written any more.
    """

    number: int
    node: VehicleNode
    over: bool = False

    @property
    def name(self) -> str:
        """Of the vehicle, and its namespace."""
        return member_name(self.number)

    @property
    def vehicle(self) -> VehicleSim:
        """The simulated one."""
        return self.node.vehicle

    def say(self, t_s: float, level: int, text: str) -> None:
        """Write what was seen of it."""
        if not self.over:
            self.node.log.event(round(t_s * _NS_PER_S), level, text)


class Room:
    """Joins the vehicles tick by tick: ``begin``, each flies the tick, ``end``.

    What one has of the others is of the tick before.

    Args:
        members: all of them, by their numbers.
        grid: of the ticks.
        feed: to the recorder.

    Raises:
        ValueError: two vehicles begin inside each other.
    """

    def __init__(self, members: Sequence[Member], grid: TickGrid, feed: Feed) -> None:
        self._grid, self._feed = grid, feed
        self._air = Air([member.vehicle.physics for member in members])
        self._pairs, self._numbers = Pairs(members, grid), [member.number for member in members]
        self._channel = feed.channel(TOPIC, FLEET_PAIR) if len(members) > 1 else 0
        self._every, self._written = max(1, round(grid.rate_hz / _LOG_HZ)), 0

    def begin(self) -> None:
        """Before a tick: jets act as they are now."""
        self._air.blow()

    def end(self, tick: int, epoch_ns: int) -> None:
        """Judge a tick that all have flown; write about ten times a second.

        Args:
            tick: its number.
            epoch_ns: Unix time of tick 0.
        """
        self._pairs.end(tick)
        if (tick + 1) % self._every == 0:
            self.write(tick, epoch_ns)

    def write(self, tick: int, epoch_ns: int) -> None:
        """Write how near each two have come until the end of a tick; arguments as of ``end``."""
        stamp_ns = epoch_ns + self._grid.ns(tick + 1)
        for pair in self._pairs.found():
            self._written += 1
            collided_ms = NEVER if pair.collided_ms is None else pair.collided_ms
            row = FleetPairRow(
                stamp_ns, self._numbers[pair.one - 1], self._numbers[pair.other - 1], pair.distance_min_m,
                pair.flying_distance_min_m, pair.ellipsoid_min, pair.violations, pair.inside_ms, collided_ms,
            )  # fmt: skip
            self._feed.write(self._channel, stamp_ns, stamp_ns, self._written, row.pack())
