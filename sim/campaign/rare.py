"""The rate of a rare failure of a scenario, by subset simulation over landings; a folder like a campaign's.

Each landing's row is kept under its seed, so that an interrupted estimate goes on where it was: what is drawn
depends on the estimate's own seed and on the rows alone.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from flightstack.common.strict_toml import ConfigError
from logs.verdict.types import VIOLATION_LIMIT_M, Outcome
from sim.campaign.rows import Row, RowsFile, write_parquet
from sim.campaign.run import ABOUT, ROWS, SUMMARY, Plan, alone, identity, known_rows
from sim.campaign.subset import Estimate, estimate
from sim.campaign.summary import why
from sim.campaign.workers import Workers, WorkersError
from sim.runners.landing import warm_up

FAILURES = "failures"  # folder of files with seeds
FAILURES_KEPT = 20
_LEAST = 1e-9  # score of what is safe, at least

OnRow = Callable[[Row], None]


class Event(Enum):
    """The failure whose rate is wanted."""

    VIOLATION = "violation"
    MISS = "miss"


def score(event: Event, row: Row, pad_radius_m: float) -> float:
    """How far a landing was from the failure, m; 0 where it is one, or may be one.

    ``violation``: lowest h outside the pad above the limit of a violation. ``miss``: the distance of the
    touch from the pad's edge; 0 for a touch beyond it, a crash, or an end that nobody declared.

    ``event``: the failure; ``row``: of the landing.
    Raises WorkersError: the landing could not be flown.
    """
    if row.outcome not in tuple(Outcome):
        raise WorkersError(f"seed {row.seed} could not be flown: {row.reason}")
    if event is Event.MISS:
        if row.outcome in (Outcome.CRASHED, Outcome.TIMEOUT):
            return 0.0
        return max(0.0, pad_radius_m - (row.touchdown_error_m or 0.0))
    if row.violation is not False:
        return 0.0
    h_m = row.h_min_outside_pad_m
    return max(_LEAST, h_m - VIOLATION_LIMIT_M) if h_m is not None else pad_radius_m


@dataclass(frozen=True)
class Rare:
    """What to estimate. Raises ConfigError: a team."""

    # scenario with its filter; ``runs`` are the landings of a level, ``first_seed`` the estimate's
    plan: Plan
    event: Event  # the failure

    def __post_init__(self) -> None:
        if not self.plan.scenario.is_alone:
            raise ConfigError(
                f"{self.plan.scenario_name}: found a team, allowed: the scenario of one vehicle; "
                "`flightstack campaign` flies teams"
            )


def fly(wanted: Rare, folder: Path, *, workers: int, on_row: OnRow) -> dict[str, Any]:
    """Fly what is missing; return the result, which is also in the folder.

    ``on_row``: called with each row, those of earlier calls included.
    Raises RowsError: the folder holds something else, or is in use; ValueError: a number of landings that
    levels cannot have; WorkersError: no worker can be kept running; RuntimeError: a landing could not be
    flown.
    """
    plan, scenario = wanted.plan, wanted.plan.first
    folder.mkdir(parents=True, exist_ok=True)
    with alone(folder):
        about = {**identity(plan), "event": wanted.event.value, "landings a level": plan.runs}
        known = {row.seed: row for row in known_rows(about, folder)}
        (folder / ABOUT).write_text(json.dumps(about, indent=1) + "\n")
        warm_up(plan.scenario)
        with (
            RowsFile(folder / ROWS) as file,
            Workers(plan.scenario_toml, workers, plan.duration_max_s) as here,
        ):

            def scores(seeds: Sequence[int]) -> list[float]:
                for row in here.fly([seed for seed in seeds if seed not in known]):
                    file.add([row])
                    known[row.seed] = row
                    on_row(row)
                return [score(wanted.event, known[seed], scenario.target.pad_radius_m) for seed in seeds]

            found = estimate(scores, plan.runs, plan.first_seed)
        write_parquet(folder / ROWS, long_seeds=True)
        told = _told(found, folder, plan, known)
        (folder / SUMMARY).write_text(json.dumps(told, indent=1) + "\n")
        return told


def _told(found: Estimate, folder: Path, plan: Plan, known: dict[int, Row]) -> dict[str, Any]:
    """What ``--json`` prints; the failures become files with their seeds."""
    place = folder / FAILURES
    place.mkdir(exist_ok=True)
    failures = []
    for number, seed in enumerate(found.failures[:FAILURES_KEPT]):
        file = place / f"{number}.seed"
        file.write_text(f"{seed}\n")
        failures.append({"why": why(known[seed]), "command": plan.command.format(seed=file)})
    return {
        "rate": found.rate,
        "interval_95": [found.low, found.high],
        "landings": found.landings,
        "levels": [asdict(level) for level in found.levels],
        "failures": failures,
    }
