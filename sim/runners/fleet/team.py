"""Several seeded landings in one room, in one process: ``land_team(team, seed)``.

Each member is a whole landing, as ``land`` flies it: vehicle, autopilot, robot, wires and companion. They go
on tick by tick. What they have of each other is of the tick before, so that their order does not matter: the
jets of the rotors, collisions, and what the companions tell each other (``Exchange``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flightstack.compiled.core import compile_core
from flightstack.core.controller import Outputs
from flightstack.core.types import Neighbour, Phase
from logs.verdict.truth import judge_truth
from sim.clock import TickGrid
from sim.runners.companion import Companion
from sim.runners.fleet.pairs import Pair, Pairs
from sim.runners.fleet.words import Words
from sim.runners.landing import Landing
from sim.scenarios.team import TeamScenario
from sim.vehicle.air import Air
from sim.vehicle.encounters import Shape, overlapping
from sim.vehicle.vehicle import VehicleSim
from sim.vehicle.vehicle import warm_up as warm_up_vehicle

# Called once a tick, when all members have flown it, with its number and the outputs of all controllers (None
# where the flight is over). Returns what each companion knows of the others from the next tick on.
Exchange = Callable[[int, Sequence[Outputs | None]], Sequence[tuple[Neighbour, ...]]]


@dataclass(frozen=True)
class TeamLanding:
    """What became of a team.

    Attributes:
        seed: of the team.
        landings: of the members, cf1 first; a verdict knows of collisions until that flight was over. Their
            wall time is the team's.
        pairs: of all members, (1, 2) first.
        waits_s: longest time that each member waited for its right of way.
        simulated_s: until the last flight was over.
        wall_s: time it took.
    """

    seed: int
    landings: tuple[Landing, ...]
    pairs: tuple[Pair, ...]
    waits_s: tuple[float, ...]
    simulated_s: float
    wall_s: float


class _Waits:
    """Ticks in a row in which each member would land and has no right of way; the most of them."""

    def __init__(self, members: int) -> None:
        self.most, self._now = [0] * members, [0] * members

    def count(self, outputs: Sequence[Outputs | None]) -> None:
        """Count a tick."""
        for n, out in enumerate(outputs):
            if out is None or out.phase is not Phase.APPROACH or out.snapshot.way.may_land:
                self._now[n] = 0
                continue
            self._now[n] += 1
            self.most[n] = max(self.most[n], self._now[n])


def land_team(team: TeamScenario, seed: int, *, exchange: Exchange | None = None) -> TeamLanding:
    """Fly the landings of a team and judge each.

    A team of one flies the same bits as ``land`` of the same seed, and so does every member whom nobody comes
    near, with its own scenario and seed (``TeamScenario.singles``).

    Args:
        team: everything that is not chance.
        seed: chance.
        exchange: what the companions tell each other; None: their controllers' own words, as late and as
            lossy as the scenario says.

    Raises:
        ValueError: two vehicles begin inside each other.
        RuntimeError: the simulation did not come to its end.
    """
    began_s = time.perf_counter()
    singles = list(team.singles(seed))
    robot = team.target_seed(seed)
    members = [
        Companion(each, own, system_id=n, target_seed=robot) for n, (each, own) in enumerate(singles, 1)
    ]
    exchange = exchange or Words(team, seed)
    grid = TickGrid(team.rate_hz)
    air = Air([member.vehicle.physics for member in members])
    pairs, waits = Pairs(members, grid), _Waits(len(members))
    for member in members:
        member.begin()
    for tick in range(max(member.ticks_max for member in members)):
        if all(member.ended for member in members):
            break
        air.blow()
        for member in members:
            member.tick(tick)
        pairs.end(tick)
        outputs = [member.outputs for member in members]
        waits.count(outputs)
        told = exchange(tick, outputs)
        for member, neighbours in zip(members, told, strict=True):
            member.neighbours = neighbours
    seen = [member.seen() for member in members]
    wall_s = time.perf_counter() - began_s
    landings = tuple(
        Landing(
            own, judge_truth(each, each.truth), each, float(each.steps.t_s[-1]), wall_s,
            member.controller.memory.retries,
        )
        for member, each, (_, own) in zip(members, seen, singles, strict=True)
    )  # fmt: skip
    simulated_s = max(landing.simulated_s for landing in landings)
    waits_s = tuple(ticks / team.rate_hz for ticks in waits.most)
    return TeamLanding(seed, landings, pairs.found(), waits_s, simulated_s, wall_s)


def warm_up(team: TeamScenario) -> None:
    """Compile everything that a team's flight calls, or load it from the cache, before a flight begins."""
    warm_up_room(team)
    compile_core(team.member[0].onboard)


def warm_up_room(team: TeamScenario) -> None:
    """The same for the vehicles alone, without their companions."""
    warm_up_vehicle(team.member[0])
    physics = VehicleSim(team.member[0], 0).physics
    Air([physics, physics]).blow()
    shape = Shape.of(physics.params)
    overlapping((shape, shape), np.zeros((2, 3)))
