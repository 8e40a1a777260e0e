"""Runs benchmarks. Results are printed; ``make bench`` runs the short ones.

``python -m tests.benchmarks NAME [ARGUMENTS]`` runs a single one.
"""

from __future__ import annotations

import sys
from importlib import import_module

# name -> module in this folder and its function
BENCHMARKS = {
    "campaign_speed": "campaign_speed:main",
    "codec": "speed:codec_times",
    "control_step": "speed:control_step",
    "environment": "speed:environment",
    "lockstep": "speed:lockstep",
    # benchmarks that take hours, or whose result is a figure or a page
    "crazyflie_faults": "crazyflie_landings:faults",
    "crazyflie_landings": "crazyflie_landings:main",
    "crazyflie_rows": "crazyflie_landings:rows",
    "fault_grid": "fault_grid:main",
    "equal_rows": "equal_rows:main",
    "fleet_faults": "fleet_faults:main",
    "landing_animation": "landing_figure:animation",
    "landing_figure": "landing_figure:main",
    "paper_runs": "flights:paper_runs",
    "proven": "proven:main",
    "px4_faults": "px4:faults",
    "px4_speed": "px4:speed",
    "tier_results": "tier_results:main",
    "vehicle_figures": "vehicle.figures:main",
}
BENCH = list(BENCHMARKS)[: list(BENCHMARKS).index("crazyflie_faults")]


def run(name: str) -> None:
    """Run the benchmark with this name; an unknown name exits with the list of names."""
    if name not in BENCHMARKS:
        sys.exit(f"no benchmark is named {name!r}; choose one of {', '.join(BENCHMARKS)}")
    module, _, function = BENCHMARKS[name].partition(":")
    getattr(import_module(f"tests.benchmarks.{module}"), function)()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        run(sys.argv.pop(1))
        sys.exit()
    for each in BENCH:
        print(f"\n== {each}", flush=True)
        run(each)
