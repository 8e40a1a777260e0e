"""A flying vehicle under a million hostile datagrams, half without a key, half with one.

By hand with another count: ``python -m tests.benchmarks.fuzz_vehicle 10000000``.
"""

import gc
import sys
import time
from pathlib import Path

from bridge.mavlink.signing.key import SigningKey
from tests.unit.autopilot.fuzz_helpers import Fuzz, intervals_us, state

DATAGRAMS = 1_000_000
BATCH = 10_000


def resident_mb() -> float:
    """Memory of this process now, MB."""
    with Path("/proc/self/status").open() as status:
        (line,) = [text for text in status if text.startswith("VmRSS")]
    return int(line.split()[1]) / 1024


def main(datagrams: int = DATAGRAMS) -> None:
    """Run and print; the first change of state, lost frame or exception ends it."""
    for name, key in (("unsigned", None), ("signed", SigningKey(bytes(range(32))))):
        fuzz = Fuzz(seed=7, key=key)
        fuzz.run(BATCH)
        before, rates, memory_mb = state(fuzz.rig), intervals_us(fuzz.rig), resident_mb()
        started = time.monotonic()
        for _ in range(datagrams // 2 // BATCH):
            fuzz.run(BATCH)
            assert state(fuzz.rig) == before
            assert all(now <= then for now, then in zip(intervals_us(fuzz.rig), rates, strict=True))
            assert fuzz.lost == 0
        gc.collect()
        wall_s = time.monotonic() - started
        print(
            f"{name}: {fuzz.datagrams} datagrams in {wall_s:.0f} s, no exception, no change of state; "
            f"{fuzz.good} good frames, {fuzz.lost} lost, {fuzz.accidents} covered by garbage with a right "
            f"checksum; {sum(fuzz.acts.values())} frames of strangers handled; "
            f"memory {resident_mb() - memory_mb:+.1f} MB"
        )
        print(f"  not let through: {fuzz.endpoint.counters.dropped()}")
        fuzz.close()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else DATAGRAMS)
