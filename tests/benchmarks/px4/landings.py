"""Landings of a real PX4 on the plant of px4-sim: scenario large with 1 kg, grid with the Crazyflie.

``python -m tests.benchmarks px4_landings [SEEDS] [SPEED] [FOLDER]``: so many seeds each (default 5), with
satellites and with motion capture, at so many times real time (default 1; below 1 on a busy machine).
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from flightstack.common.processes import LaunchError
from flightstack.core.parameters.flight import path_of
from logs.reader.flight import load_flight
from logs.verdict.verdict import Verdict, judge
from tests.px4_flight import Px4Flight, flying
from tests.px4_program import PX4_PLACE, px4_place


class SetUp(NamedTuple):
    """What is flown, and the configuration that goes with it."""

    scenario: str
    config: Path
    mocap: bool


SET_UPS = [
    SetUp(scenario, path_of(config), mocap)
    for mocap in (True, False)
    for scenario, config in (("grid", "px4-crazyflie"), ("large", "px4-1kg"))
]


def fly(place: Path, set_up: SetUp, seed: int, speed: float, folder: Path) -> Verdict:
    """One flight, judged by the truth.

    Raises:
        LaunchError: a process did not start.
    """
    flight = Px4Flight(set_up.scenario, set_up.config, folder, seed, set_up.mocap, speed)
    with flying(place, flight) as one:
        one.fly()
        log = one.log
    return judge(load_flight(log))


def main() -> None:
    """Fly and print."""
    place = px4_place()
    if place is None:
        print(f"no PX4 here: {PX4_PLACE} names none; nothing flown")
        return
    given = dict(enumerate(sys.argv[1:]))
    seeds, speed = int(given.get(0, "5")), float(given.get(1, "1"))
    folder = Path(given[2]) if 2 in given else Path(tempfile.mkdtemp(prefix="px4-landings-"))
    print(f"logs: {folder}", flush=True)
    found: dict[SetUp, list[Verdict]] = {set_up: [] for set_up in SET_UPS}
    for seed in range(seeds):
        for set_up in SET_UPS:
            sensed = "mocap" if set_up.mocap else "satellites"
            name = f"{set_up.scenario}-{sensed}-{seed}"
            try:
                verdict = fly(place, set_up, seed, speed, folder / name)
            except (LaunchError, ValueError) as error:
                print(f"{name}: not flown: {error}", flush=True)
                continue
            found[set_up].append(verdict)
            print(f"{name}: {_words(verdict)}", flush=True)
    print("| scenario | position by | landed | crashed | violations | error, median | highest |")
    print("|---|---|---|---|---|---|---|")
    for set_up, verdicts in found.items():
        print(_row(set_up, verdicts))


def _words(verdict: Verdict) -> str:
    error = verdict.touchdown_error_m
    where = f"{100.0 * error:.1f} cm" if error is not None else "no touchdown"
    return f"{verdict.outcome.value}, {where}, violation {verdict.violation}"


def _row(set_up: SetUp, verdicts: list[Verdict]) -> str:
    errors = [100.0 * v.touchdown_error_m for v in verdicts if v.touchdown_error_m is not None]
    size = f"{statistics.median(errors):.1f} cm | {max(errors):.1f} cm" if errors else "none | none"
    outcomes = [v.outcome.value for v in verdicts]
    count = f"{outcomes.count('landed')} of {len(verdicts)} | {outcomes.count('crashed')}"
    sensed = "motion capture" if set_up.mocap else "satellites"
    violations = sum(v.violation is not False for v in verdicts)
    return f"| `{set_up.scenario}` | {sensed} | {count} | {violations} | {size} |"


if __name__ == "__main__":
    main()
