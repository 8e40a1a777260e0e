"""Compares landings in batches of ticks with landings tick by tick: rows must be equal bit for bit.

``python -m tests.benchmarks equal_rows [NAME ...] [--seed N] [--runs N] [--workers N]``

NAME: a tier with its filter, for example ``field_paper``. Exit status 1 if a row differs.
"""

import argparse
import multiprocessing
import os
import sys
from dataclasses import replace
from functools import cache, partial

from sim.campaign.rows import Row, row_of
from sim.runners.landing import land, warm_up
from sim.scenarios.scenario import Scenario, load

NAMES = [
    f"{tier}_{kind}" for tier in ("lab", "room", "field", "storm", "deck") for kind in ("robust", "paper")
]


@cache
def scenario(name: str) -> Scenario:
    """Return the scenario ``TIER_FILTER``; the function also compiles the simulator code for it."""
    tier, _, kind = name.rpartition("_")
    found = load(tier).with_filter(kind)
    warm_up(found)
    return found


def both(name: str, seed: int) -> tuple[Row, Row]:
    """Return the rows of one landing, flown in batches and flown tick by tick, both without wall time."""
    flown = (land(scenario(name), seed), land(scenario(name), seed, on_step=lambda _tick, _out: None))
    one, other = (replace(row_of(each), wall_s=0.0) for each in flown)
    return one, other


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help=f"of {', '.join(NAMES)}; none: all")
    parser.add_argument("--seed", type=int, default=30_001, help="the first")
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    asked, differ = parser.parse_args(), False
    if unknown := set(asked.names) - set(NAMES):
        parser.error(f"found {sorted(unknown)}, allowed are {', '.join(NAMES)}")
    seeds = range(asked.seed, asked.seed + asked.runs)
    with multiprocessing.get_context("spawn").Pool(asked.workers) as pool:
        for name in asked.names or NAMES:
            scenario(name)  # compiled here first; the workers load the stored code
            pairs = pool.map(partial(both, name), seeds, chunksize=10)
            others = [one.seed for one, other in pairs if repr(one) != repr(other)]
            differ |= bool(others)
            told = f"{len(pairs) - len(others)} of {len(pairs)} equal"
            print(f"{name}: {told}; differ: {others[:5] or 'none'}", flush=True)
    sys.exit(differ)
