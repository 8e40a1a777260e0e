"""Scenarios (default: all) flown in lockstep with ten seeds and replayed from the log: equal to the bit.

python -m tests.benchmarks replay [SEEDS [SCENARIO ...]]
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from logs.replay.replay import ReplayError, replay
from logs.schema.controller_rows import TickInputs, pack_controller_input
from sim.scenarios.scenario import names
from tests.benchmarks.control_step import inputs


def fly(scenario: str, seed: int, folder: str) -> Path:
    """One run of ``flightstack sitl``; its log."""
    subprocess.run(
        [sys.executable, "-m", "flightstack.cli.main", "sitl", "--scenario", scenario, "--seed", str(seed),
         "--lockstep", "--json", "--no-report", "--out", folder],
        capture_output=True, timeout=300, check=False,
    )  # fmt: skip
    return Path(folder) / "flight.mcap"


def row(scenario: str, seeds: int) -> tuple[str, int]:
    """One line: how many logs are equal and what a replay takes; and how many are not."""
    took, ticks, unequal = [], 0, []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            log = fly(scenario, seed, folder)
            started = time.perf_counter()
            try:
                result = replay(log)
            except ReplayError as error:
                unequal.append(f"seed {seed}: {error}")
                continue
            took.append(time.perf_counter() - started)
            ticks += result.compared
            if not result.equal or result.wire is None:
                first = (*result.outputs.first, *result.states.first, *(result.wire or result.states).first)
                unequal.append(f"seed {seed}: {json.dumps(str(first[:1]))}")
    median_s = statistics.median(took) if took else float("nan")
    text = f"{scenario:16} {seeds - len(unequal)} of {seeds} equal, {ticks} ticks, {median_s:.2f} s a replay"
    return "\n  ".join([text, *unequal]), len(unequal)


def pack_us() -> float:
    """Median microseconds of packing the inputs of a tick, one target sample in it."""
    given, took = inputs(1), []
    for tick in range(20_000):
        started = time.perf_counter_ns()
        pack_controller_input(TickInputs(1_577_836_800_000_000_000, tick, tick * 0.01, given, False))
        took.append((time.perf_counter_ns() - started) / 1e3)
    return statistics.median(took)


def main() -> None:
    """Run and print; an assertion fails if one log is not equal."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print(f"inputs of a tick: {pack_us():.1f} us to pack (limit 5)")
    unequal = 0
    for scenario in sys.argv[2:] or names():
        text, count = row(scenario, seeds)
        unequal += count
        print(text, flush=True)
    assert not unequal, f"{unequal} logs are not equal"


if __name__ == "__main__":
    main()
