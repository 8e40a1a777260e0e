"""Many flights: the paper's runs, replays, kills at random moments, and hostile datagrams."""

from __future__ import annotations

import gc
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

from bridge.mavlink.signing.key import SigningKey
from logs.replay.replay import ReplayError, replay
from logs.schema.controller_rows import TickInputs, pack_controller_input
from sim.scenarios.scenario import names
from tests.benchmarks.speed import inputs, sitl
from tests.integration.flights.test_crash_safety import OWN_TOPIC, Crash, FlightOverError, crash
from tests.unit.autopilot.fuzz_helpers import Fuzz, intervals_us, state

SCENARIOS = ("paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2")


def paper_row(scenario: str, seeds: int, filter_name: str) -> str:
    """One line of the table."""
    runs = []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(sitl(folder, scenario, seed, "--lockstep", "--filter", filter_name))
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


def paper_runs() -> None:
    """The paper's four runs in lockstep, the table of docs/reference/paper_runs.md: [SEEDS [FILTER ...]]."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    for filter_name in sys.argv[2:] or ("paper", "robust"):
        print(f"filter {filter_name}")
        for scenario in SCENARIOS:
            print(paper_row(scenario, seeds, filter_name), flush=True)


def replay_row(scenario: str, seeds: int) -> tuple[str, int]:
    """One line: how many logs are equal and what a replay takes; and how many are not."""
    took, ticks, unequal = [], 0, []
    for seed in range(seeds):
        with tempfile.TemporaryDirectory() as folder:
            sitl(folder, scenario, seed, "--lockstep")
            log = Path(folder) / "flight.mcap"
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


def replays() -> None:
    """Scenarios flown in lockstep and replayed from the log, equal to the bit: [SEEDS [SCENARIO ...]]."""
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print(f"inputs of a tick: {pack_us():.1f} us to pack (limit 5)")
    unequal = 0
    for scenario in sys.argv[2:] or names():
        text, count = replay_row(scenario, seeds)
        unequal += count
        print(text, flush=True)
    assert not unequal, f"{unequal} logs are not equal"


CRASHES = 50
# The recorder's own death is what costs data: half of the runs are its.
VICTIMS = ("record", "vehicle", "record", "onboard", "record", "target", "record", "launcher")


def crash_safety() -> None:
    """Kills at random moments, each process of a run in turn, in lockstep and in real time: [RUNS]."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else CRASHES
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


DATAGRAMS = 1_000_000
BATCH = 10_000


def resident_mb() -> float:
    """Memory of this process now, MB."""
    with Path("/proc/self/status").open() as status:
        (line,) = [text for text in status if text.startswith("VmRSS")]
    return int(line.split()[1]) / 1024


def fuzz_vehicle() -> None:
    """A flying vehicle under hostile datagrams, half without a key, half with one: [DATAGRAMS].

    The first change of state, lost frame or exception ends it.
    """
    datagrams = int(sys.argv[1]) if len(sys.argv) > 1 else DATAGRAMS
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
