"""Speed of landings in campaigns and of teams on one core, as a multiple of real time."""

from __future__ import annotations

import gc
import statistics
import sys
import time

from flightstack.common.pacing import quiet_garbage_collector
from sim.runners.landing import land_team, warm_up
from sim.scenarios.team import TeamScenario, load

LANDINGS = 8
ASKED = 200.0


def flown_s(scenario: TeamScenario, seed: int) -> float:
    """Fly a landing or a team; return the simulated time of all its vehicles."""
    return sum(each.simulated_s for each in land_team(scenario, seed).landings)


def main(scenario_name: str = "lab") -> None:
    """Fly, measure, print; arguments: the scenario, and a filter that replaces the scenario's filter."""
    if len(sys.argv) > 1:
        scenario_name = sys.argv[1]
    scenario = load(scenario_name)
    if len(sys.argv) > 2:
        scenario = scenario.with_filter(sys.argv[2])
        scenario_name += f", {sys.argv[2]}"
    warm_up(scenario)
    flown_s(scenario, 0)
    quiet_garbage_collector()
    factors, spent = [], []
    for seed in range(LANDINGS):
        began_s = time.process_time()
        simulated_s = flown_s(scenario, seed)
        spent.append(time.process_time() - began_s)
        factors.append(simulated_s / spent[-1])
        gc.collect()
    print(
        f"{scenario_name}: {statistics.median(factors):.0f} x real time on one core (asked {ASKED:.0f}), "
        f"{min(factors):.0f} to {max(factors):.0f} in {LANDINGS} flights of one seed, vehicle by vehicle; "
        f"{statistics.median(spent):.3f} s of processor time a flight"
    )
