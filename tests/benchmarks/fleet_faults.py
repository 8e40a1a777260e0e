"""Flies teams of ``fleet_3`` in which one member fails at a random time, or messages are late or lost.

``python -m tests.benchmarks fleet_faults [--runs N] [--first SEED] [--only KIND ...]``

It prints a table row for each kind of fault. The failed member and its neighbours are counted separately.
"""

import argparse
import gc
from collections import Counter
from dataclasses import dataclass, field, replace

from logs.verdict.types import Outcome
from logs.verdict.verdict import FleetVerdict
from sim.campaign.rows import judge_landing
from sim.chance import stream
from sim.runners.landing import Exchange, land, warm_up
from sim.scenarios.scenario import Scenario, load
from sim.scenarios.tables import ExchangeLink
from tests.fault_grid.fleet import Way, broken

TEAM = "fleet_3"
FROM_S, UNTIL_S = 0.5, 6.5  # range of the time at which the member fails
KINDS: dict[str, Way | None] = {"killed": Way.KILLED, "silent": Way.SILENT, "cut": Way.CUT, "late": None}
NAMES = {"late": "10 % of the messages lost, 0.1 s late"}
LATE = ExchangeLink(delay_s=0.1, loss=0.1)
COLUMNS = (
    "fault", "teams", "landed", "aborted", "crashed", "barrier violations", "collisions",
    "ellipsoid violations", "least rho", "least distance", "failing member: landed / aborted / crashed",
    "failing member: barrier violations",
)  # fmt: skip


@dataclass
class Counts:
    """Results of all teams with one kind of fault; ``own``: results of the failed members."""

    teams: int = 0
    others: Counter[Outcome] = field(default_factory=Counter)
    own: Counter[Outcome] = field(default_factory=Counter)
    others_violated: int = 0
    own_violated: int = 0
    collisions: int = 0
    inside: int = 0
    ellipsoid_min: float = float("inf")
    distance_min_m: float = float("inf")

    def add(self, verdict: FleetVerdict, who: int) -> None:
        """Add the result of a team; ``who``: number of the failed member; 0: no member failed."""
        self.teams += 1
        self.collisions += verdict.collisions or 0
        self.inside += verdict.ellipsoid_violations or 0
        if verdict.ellipsoid_min is not None:
            self.ellipsoid_min = min(self.ellipsoid_min, verdict.ellipsoid_min)
        if verdict.distance_min_m is not None:
            self.distance_min_m = min(self.distance_min_m, verdict.distance_min_m)
        for number, member in enumerate(verdict.members.values(), 1):
            (self.own if number == who else self.others)[member.outcome] += 1
            self.own_violated += number == who and member.violation is not False
            self.others_violated += number != who and member.violation is not False


def failing(whole: Scenario, kind: str, seed: int) -> tuple[Scenario, Exchange | None, int]:
    """Return team and messages of a seed, and the number of the failed member; 0: no member failed."""
    way = KINDS[kind]
    if way is None:
        return replace(whole, exchange=LATE), None, 0
    chance = stream(seed, "broken")
    who = int(chance.integers(1, len(whole.members) + 1))
    at_s = round(float(chance.uniform(FROM_S, UNTIL_S)), 2)
    return *broken(whole, seed, way, who, at_s), who


def line(kind: str, found: Counts) -> str:
    own = " / ".join(str(found.own[each]) for each in (Outcome.LANDED, Outcome.ABORTED, Outcome.CRASHED))
    cells = (
        KINDS[kind] or NAMES[kind],
        found.teams,
        f"{found.others[Outcome.LANDED]} of {found.others.total()}",
        found.others[Outcome.ABORTED],
        found.others[Outcome.CRASHED],
        found.others_violated,
        found.collisions,
        found.inside,
        f"{found.ellipsoid_min:.2f}",
        f"{found.distance_min_m:.2f} m",
        own if found.own else "-",
        found.own_violated if found.own else "-",
    )
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=120, help="teams of each kind")
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--only", nargs="*", choices=KINDS, default=list(KINDS), help="fly these only")
    asked = parser.parse_args()
    whole = load(TEAM)
    warm_up(whole)
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}", flush=True)
    for kind in asked.only:
        found = Counts()
        for seed in range(asked.first, asked.first + asked.runs):
            team, exchange, who = failing(whole, kind, seed)
            found.add(judge_landing(land(team, seed, exchange=exchange)), who)
            gc.collect()
        print(line(kind, found), flush=True)
