"""Seeded landings in one process without sockets, recorded and judged: ``land`` and ``land_team``.

The code is the same as with separate processes: the vehicle's lockstep loop with its autopilot and faults,
the robot, the companion's link and its runner of ticks. Only the messages are passed directly, with the
rounding of the wire. So a landing equals ``flightstack sitl --lockstep`` of the same scenario and seed to the
last bit.

Vehicles that share a room fly tick by tick. They act on each other one tick later, so their order does not
matter: by rotor jets, collisions, and messages between the companions (``Exchange``). A single vehicle flies
batches of ticks where possible.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS
from flightstack.compiled.jit import telling
from flightstack.core.controller import Outputs
from flightstack.core.types import Neighbour, Phase
from logs.recorder.feed import Feed
from logs.verdict.truth import judge_truth
from logs.verdict.types import Verdict
from sim.clock import TickGrid
from sim.runners.companion import Companion, OnStep
from sim.runners.lockstep import Exchange, LockstepWorld
from sim.runners.notes import Seen
from sim.runners.room import Pair, Room, Words, warm_up_room
from sim.scenarios.scenario import Scenario, load
from sim.scenarios.team import TeamScenario, alone


@dataclass(frozen=True)
class Landing:
    """Result of one vehicle's flight."""

    seed: int  # seed of all random draws
    verdict: Verdict  # verdict from true states, as for a flight log
    seen: Seen  # recorded data that the verdict needs
    simulated_s: float  # duration of the flight, simulated time
    wall_s: float  # duration of the flight, wall time; in a team, of the whole team
    retries: int  # number of restarts of the landing


@dataclass(frozen=True)
class TeamLanding:
    """Result of a team's flight."""

    seed: int  # seed of the team
    landings: tuple[Landing, ...]  # cf1 first; a verdict covers collisions until that member's flight ended
    pairs: tuple[Pair, ...]  # all pairs of members, (1, 2) first
    waits_s: tuple[float, ...]  # longest time that each member waited for its right of way
    simulated_s: float  # time until the last flight ended
    wall_s: float


class _Waits:
    """For each member: longest number of consecutive ticks in which it waits for its right of way."""

    def __init__(self, members: int) -> None:
        self.most, self._now = [0] * members, [0] * members

    def count(self, outputs: Sequence[Outputs | None]) -> None:
        for n, out in enumerate(outputs):
            if out is None or out.phase is not Phase.APPROACH or out.snapshot.way.may_land:
                self._now[n] = 0
                continue
            self._now[n] += 1
            self.most[n] = max(self.most[n], self._now[n])


def land(scenario: Scenario, seed: int, *, on_step: OnStep | None = None) -> Landing:
    """Fly one landing and judge it.

    Args:
        scenario: the whole scenario; its ``onboard`` part configures the flown controller.
        seed: seed of all random draws.
        on_step: called after every controller step.

    Raises:
        RuntimeError: the simulation did not end.
    """
    return land_team(alone(scenario), seed, on_step=on_step).landings[0]


def land_team(
    team: TeamScenario, seed: int, *, exchange: Exchange | None = None, on_step: OnStep | None = None
) -> TeamLanding:
    """Fly the landings of a team and judge each of them.

    A member that no other member approaches flies exactly as ``land`` does with its own scenario and seed
    (``TeamScenario.singles``).

    ``exchange``: computes the messages between companions from the outputs of all controllers (None after the
    end of a flight); None: the controllers' messages, with the scenario's delay and loss; ``on_step``: called
    after every controller step of a vehicle that is alone. Raises ValueError: two vehicles overlap at the
    start; RuntimeError: the simulation did not end.
    """
    began_s = time.perf_counter()
    singles = list(team.singles(seed))
    robot = team.target_seed(seed)
    members = [
        Companion(each, own, on_step, system_id=n, target_seed=robot, alone=team.is_alone)
        for n, (each, own) in enumerate(singles, 1)
    ]
    waits = _Waits(len(members))
    pairs = _fly(team, members, exchange or Words(team, seed), waits)
    seen = [member.seen() for member in members]
    judged = [judge_truth(each, each.truth) for each in seen]
    wall_s = time.perf_counter() - began_s
    landings = tuple(
        Landing(own, verdict, each, float(each.steps.t_s[-1]), wall_s, member.controller.memory.retries)
        for member, each, verdict, (_, own) in zip(members, seen, judged, singles, strict=True)
    )
    simulated_s = max(landing.simulated_s for landing in landings)
    waits_s = tuple(ticks / team.rate_hz for ticks in waits.most)
    return TeamLanding(seed, landings, pairs, waits_s, simulated_s, wall_s)


def _fly(
    team: TeamScenario, members: Sequence[Companion], exchange: Exchange, waits: _Waits
) -> tuple[Pair, ...]:
    """Fly until all flights are over; return the smallest distances of all pairs."""
    if team.is_alone:
        members[0].fly()
        return ()

    def counted(tick: int, outputs: Sequence[Outputs | None]) -> Sequence[tuple[Neighbour, ...]]:
        waits.count(outputs)
        return exchange(tick, outputs)

    feed = Feed.connect(None, "vehicle", lossless=False)
    room = Room([member.node for member in members], TickGrid(team.rate_hz), feed)
    loops = [member.loop for member in members]
    LockstepWorld(loops, room, counted, Stop(), EPOCH_NS).run(max(member.ticks_max for member in members))
    return room.found()


def warm_up(team: TeamScenario) -> None:
    """Compile all code of a flight, or load it from the cache, before the first flight starts."""
    first = team.member[0]
    warm_up_room(team)
    with telling("the loop of a campaign, about 20 s"):
        stretch = Companion(first, 0).stretch
        if stretch is not None and team.is_alone:
            stretch.warm_up()


if __name__ == "__main__":  # so that no campaign has to wait for it
    warm_up(alone(load("lab")))
