"""Kills at random moments: each process of a run in turn, in lockstep and in real time.

``python -m tests.benchmarks crash_safety [RUNS]``, 50 by default: about ten seconds each.
"""

import sys
import tempfile
from pathlib import Path

from tests.integration.flights.crash_runs import OWN_TOPIC, Crash, FlightOverError, crash

RUNS = 50
# The recorder's own death is what costs data: half of the runs are its.
VICTIMS = ("record", "vehicle", "record", "onboard", "record", "target", "record", "launcher")


def main() -> None:
    """Run and print."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    found: list[Crash] = []
    for seed in range(runs):
        victim, lockstep = VICTIMS[seed % len(VICTIMS)], bool(seed // 2 % 2)
        last = _crash(victim, seed, lockstep)
        found.append(last)
        print(
            f"{seed:3} {victim:8} {'lockstep' if lockstep else 'real time':9} "
            f"{last.messages:6} messages, missing {last.missing_s:.3f} s",
            flush=True,
        )
    print(f"{len(found)} runs: every log opened by itself, and by its index once recovered")
    for victim in OWN_TOPIC:
        some = [c for c in found if c.victim == victim and not c.lockstep]
        if some:
            print(f"{victim:8} real time: missing at most {max(c.missing_s for c in some):.3f} s (limit 0.5)")
    some = [c for c in found if c.victim == "record" and c.lockstep]
    if some:
        simulated = [c.missing_simulated_s or 0.0 for c in some]
        print(
            f"record   lockstep: missing at most {max(c.missing_s for c in some):.3f} s of wall time "
            f"(limit 0.5), {max(simulated):.2f} s simulated"
        )


def _crash(victim: str, seed: int, lockstep: bool) -> Crash:
    for other in range(5):  # other moments, if the flight was over before the first
        with tempfile.TemporaryDirectory() as folder:
            try:
                return crash(Path(folder), victim, seed + 1000 * other, lockstep=lockstep)
            except FlightOverError as error:
                print(f"{seed:3} {victim:8} again: {error}", flush=True)
    raise RuntimeError(f"five flights of seed {seed} ended before {victim} could be killed")


if __name__ == "__main__":
    main()
