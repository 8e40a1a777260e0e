"""How near the members of a team come to each other, and who collides with whom."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from logs.schema.events import Severity
from sim.clock import TickGrid
from sim.compiled.records import F64
from sim.runners.companion import Companion
from sim.vehicle.encounters import Shape, nearest, overlaps

_MS_PER_S = 1000.0


@dataclass(slots=True)
class Pair:
    """How near two members came.

    Attributes:
        one: number of the one, from 1.
        other: number of the other, a higher one.
        distance_min_m: smallest distance of their centres of mass at any time.
        flying_distance_min_m: the same while both flew; infinite if they never did at once.
        ellipsoid_min: smallest distance in the ellipsoid's measure while both flew; below 1: inside.
        violations: number of times that they came inside.
        inside_ms: length of the ticks in which they were inside.
        collided_ms: when their shapes overlapped first; None: never.
    """

    one: int
    other: int
    distance_min_m: float = math.inf
    flying_distance_min_m: float = math.inf
    ellipsoid_min: float = math.inf
    violations: int = 0
    inside_ms: int = 0
    collided_ms: int | None = None


class Pairs:
    """Follows all pairs; who collides breaks its propellers at the end of that tick.

    Attributes:
        all: the pairs, (1, 2) first.

    Args:
        members: of the team.
        grid: of their ticks.

    Raises:
        ValueError: two vehicles begin inside each other.
    """

    def __init__(self, members: Sequence[Companion], grid: TickGrid) -> None:
        self._members, self._grid = members, grid
        self._shapes = [Shape.of(member.vehicle.physics.params) for member in members]
        self.all = [Pair(i, j) for i, j in combinations(range(1, len(members) + 1), 2)]
        self._inside = [False] * len(self.all)
        self._before, self._flew = self._states(), self._flying()
        for pair in self.all:
            i, j = pair.one - 1, pair.other - 1
            if overlaps(self._before[j] - self._before[i], self._shapes[i], self._shapes[j]):
                place = ", ".join(f"{each:.2f}" for each in self._before[i, :3])
                raise ValueError(
                    f"{members[i].name} and {members[j].name} begin inside each other, at ({place}) m; "
                    "give them other start places"
                )

    def begin(self) -> None:
        """Note where all are at the begin of a tick."""
        self._before, self._flew = self._states(), self._flying()

    def end(self, tick: int) -> None:
        """Judge a tick that all have flown.

        Args:
            tick: its number.
        """
        after, flying, grid = self._states(), self._flying(), self._grid
        flew = [each and now for each, now in zip(self._flew, flying, strict=True)]
        begin_ms, steps = grid.ms(tick), grid.ms(tick + 1) - grid.ms(tick)
        hits: list[tuple[int, Pair]] = []
        for number, pair in enumerate(self.all):
            i, j = pair.one - 1, pair.other - 1
            relative = self._before[j] - self._before[i]
            found = nearest(relative, after[j] - after[i], steps, self._shapes[i], self._shapes[j])
            pair.distance_min_m = min(pair.distance_min_m, found.distance_m)
            both = flew[i] and flew[j]
            if both:
                pair.flying_distance_min_m = min(pair.flying_distance_min_m, found.distance_m)
                pair.ellipsoid_min = min(pair.ellipsoid_min, found.ellipsoid)
            inside = both and found.ellipsoid < 1.0
            pair.violations += inside and not self._inside[number]
            pair.inside_ms += steps * inside
            self._inside[number] = inside
            if found.overlap_ms >= 0 and pair.collided_ms is None:
                pair.collided_ms = begin_ms + found.overlap_ms
                hits.append((pair.collided_ms, pair))
        self._collide(hits)

    def _collide(self, hits: Sequence[tuple[int, Pair]]) -> None:
        for at_ms, pair in hits:
            for own, other in ((pair.one, pair.other), (pair.other, pair.one)):
                text = f"collision with {self._members[other - 1].name}"
                self._members[own - 1].say(at_ms / _MS_PER_S, Severity.ERROR, text)
        for number in {number for _, pair in hits for number in (pair.one, pair.other)}:
            self._members[number - 1].vehicle.collide()

    def _states(self) -> F64:
        """Position (m) and velocity (m/s) of all, (N, 6), ENU."""
        return np.array([member.vehicle.body()[:6] for member in self._members])

    def _flying(self) -> list[bool]:
        """Whether each flies: motors turning, off the ground and off a pad."""
        vehicles = [member.vehicle for member in self._members]
        return [each.motors_running and not (each.on_pad or each.on_ground) for each in vehicles]
