"""Flies teams of ``fleet_3`` in which one member fails at a random time, or messages are late or lost.

``python -m tests.benchmarks fleet_faults [--runs N] [--first SEED] [--only KIND ...]``

The benchmark prints a table row for each kind of fault. The failed member and its neighbours are counted
separately.
"""

import argparse
import gc
from collections import Counter
from dataclasses import replace

from logs.verdict.types import Outcome
from logs.verdict.verdict import FleetVerdict
from sim.campaign.rows import judge_landing
from sim.chance import stream
from sim.runners.landing import Exchange, land, warm_up
from sim.scenarios.scenario import Scenario, load
from sim.scenarios.tables import ExchangeLink
from tests.fault_grid.fleet import Way, broken

TEAM = "fleet_3"
FROM_S, UNTIL_S = 0.5, 6.5  # range of the time at which the member fails, s
KINDS: dict[str, Way | None] = {"killed": Way.KILLED, "silent": Way.SILENT, "cut": Way.CUT, "late": None}
NAMES = {"late": "10 % of the messages lost, 0.1 s late"}
ENDS = (Outcome.LANDED, Outcome.ABORTED, Outcome.CRASHED)
LATE = ExchangeLink(delay_s=0.1, loss=0.1)
COLUMNS = (
    "fault", "teams", "landed", "aborted", "crashed", "barrier violations", "collisions",
    "ellipsoid violations", "least rho", "least distance", "failing member: landed / aborted / crashed",
    "failing member: barrier violations",
)  # fmt: skip


def failing(whole: Scenario, kind: str, seed: int) -> tuple[Scenario, Exchange | None, int]:
    """Return the team, the exchange of its messages, and the number of the member that fails (0: none)."""
    way = KINDS[kind]
    if way is None:
        return replace(whole, exchange=LATE), None, 0
    chance = stream(seed, "broken")
    who = int(chance.integers(1, len(whole.members) + 1))
    at_s = round(float(chance.uniform(FROM_S, UNTIL_S)), 2)
    return *broken(whole, seed, way, who, at_s), who


def line(kind: str, found: list[tuple[FleetVerdict, int]]) -> str:
    """Return the table row of a kind of fault; ``found``: for each team, verdict and failed member."""
    ends = [(n == who, each) for verdict, who in found for n, each in enumerate(verdict.members.values(), 1)]
    own, others = ([each for failed, each in ends if failed is wanted] for wanted in (True, False))
    own_ends, ended = Counter(each.outcome for each in own), Counter(each.outcome for each in others)
    verdicts = [verdict for verdict, _ in found]
    cells = (
        KINDS[kind] or NAMES[kind],
        len(found),
        f"{ended[Outcome.LANDED]} of {len(others)}",
        ended[Outcome.ABORTED],
        ended[Outcome.CRASHED],
        sum(each.violation is not False for each in others),
        sum(each.collisions or 0 for each in verdicts),
        sum(each.ellipsoid_violations or 0 for each in verdicts),
        f"{min(each.ellipsoid_min for each in verdicts if each.ellipsoid_min is not None):.2f}",
        f"{min(each.distance_min_m for each in verdicts if each.distance_min_m is not None):.2f} m",
        " / ".join(str(own_ends[each]) for each in ENDS) if own else "-",
        sum(each.violation is not False for each in own) if own else "-",
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
        found = []
        for seed in range(asked.first, asked.first + asked.runs):
            team, exchange, who = failing(whole, kind, seed)
            found.append((judge_landing(land(team, seed, exchange=exchange)), who))
            gc.collect()
        print(line(kind, found), flush=True)
