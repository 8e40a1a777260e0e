"""Runs benchmarks and prints their results; ``make bench`` runs the short benchmarks.

``python -m tests.benchmarks NAME [ARGUMENTS]`` runs a single benchmark.
"""

from __future__ import annotations

import sys
from importlib import import_module

BENCH = {  # name: module in this folder and its function
    "campaign_speed": "speed:campaign_speed",
    "control_step": "speed:control_step",
    "environment": "speed:environment",
    "lockstep": "speed:lockstep",
}
LONG = {  # benchmarks that take hours, or whose result is a page
    "crazyflie_landings": "crazyflie_landings:main",
    "equal_rows": "equal_rows:main",
    "fault_grid": "fault_grid:main",
    "fleet_faults": "fleet_faults:main",
    "paper_runs": "speed:paper_runs",
    "proven": "proven:main",
    "px4_faults": "px4_faults:main",
    "tier_results": "tier_results:main",
}


def run(name: str) -> None:
    """Run the benchmark with this name; an unknown name exits with the list of names."""
    known = BENCH | LONG
    if name not in known:
        sys.exit(f"no benchmark is named {name!r}; choose one of {', '.join(known)}")
    module, _, function = known[name].partition(":")
    getattr(import_module(f"tests.benchmarks.{module}"), function)()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run(sys.argv.pop(1))
        sys.exit()
    for each in BENCH:
        print(f"\n== {each}", flush=True)
        run(each)
