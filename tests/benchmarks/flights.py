"""Flies the paper's runs many times."""

from __future__ import annotations

import statistics
import sys
import tempfile

from tests.benchmarks.speed import sitl

SCENARIOS = ("paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2")


def paper_row(scenario: str, seeds: int, filter_name: str) -> str:
    runs = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(sitl(folder, scenario, seed, "--lockstep", "--filter", filter_name))
    landed = sum(run["outcome"] == "landed" for run in runs)
    violations = sum(run["violation"] is not False for run in runs)  # unknown counts as a violation
    median = {
        key: statistics.median(run[key] for run in runs if run[key] is not None)
        for key in ("touchdown_error_m", "touchdown_speed_vertical_m_s", "time_to_land_s")
    }
    lowest, outside = (1e3 * min(run[k] for run in runs) for k in ("h_min_m", "h_min_outside_pad_m"))
    return (
        f"| `{scenario}` | {landed} of {seeds} | {violations} | {outside:+.1f} mm | {lowest:+.0f} mm "
        f"| {1e3 * median['touchdown_error_m']:.0f} mm | {median['touchdown_speed_vertical_m_s']:.2f} m/s "
        f"| {median['time_to_land_s']:.1f} s |"
    )


def paper_runs() -> None:
    """Fly the paper's four runs in lockstep for docs/reference/paper_runs.md: [SEEDS [FILTER ...]]."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for filter_name in sys.argv[2:] or ("paper", "robust"):
        print(f"filter {filter_name}")
        for scenario in SCENARIOS:
            print(paper_row(scenario, seeds, filter_name), flush=True)
