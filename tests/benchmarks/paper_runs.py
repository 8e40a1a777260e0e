"""The paper's four runs, twenty seeds each, in lockstep: the table of the README.

python -m tests.benchmarks.paper_runs [SEEDS]
"""

import statistics
import sys

from tests.benchmarks.lockstep import fly

SCENARIOS = ("paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2")


def row(scenario: str, seeds: int, filter_name: str) -> str:
    """One line of the table."""
    runs = [
        fly("--scenario", scenario, "--lockstep", "--seed", str(seed), "--filter", filter_name)
        for seed in range(seeds)
    ]
    landed = sum(run["outcome"] == "landed" for run in runs)
    violations = sum(run["violation"] is not False for run in runs)  # not known counts as one
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


def main() -> None:
    """Run and print."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for filter_name in sys.argv[2:] or ("paper", "robust"):
        print(f"filter {filter_name}")
        for scenario in SCENARIOS:
            print(row(scenario, seeds, filter_name), flush=True)


if __name__ == "__main__":
    main()
