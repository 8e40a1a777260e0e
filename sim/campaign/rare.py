"""Rate of a rare failure of a scenario, from subset simulation over landings; a folder like a campaign's.

Each landing's row is stored under its seed, so an interrupted estimate can continue: the random draws depend
only on the estimate's seed and on the rows.

Subset simulation (Au and Beck 2001, doi:10.1016/S0266-8920(01)00019-4) estimates rates that are too small for
counting. Each landing has a score that decreases towards the failure; a failure has a score of 0 or less. The
landings of the first level are independent draws. Those with the lowest scores start chains of moves
(``sim.chance``) that do not exceed these scores: the landings of the chains are the next level. The rate is
the product of the levels' shares. The weight of the moves is adapted to the share of accepted ones
(Papaioannou et al. 2015).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from flightstack.common.strict_toml import ConfigError
from logs.tools.file import of_file
from logs.verdict.types import VIOLATION_LIMIT_M, Outcome
from sim.campaign.rows import Row, RowsFile, write_parquet
from sim.campaign.run import ABOUT, ROWS, SUMMARY, Plan, alone, identity, known_rows
from sim.campaign.summary import why
from sim.campaign.workers import Workers, WorkersError
from sim.chance import MOVE_SEED_MAX, fresh, moved
from sim.runners.landing import warm_up

FAILURES = "failures"  # folder of files with the seeds of failures
FAILURES_KEPT = 20
_LEAST = 1e-9  # smallest score of a landing that did not fail

OnRow = Callable[[Row], None]
SHARE = 0.1  # share of a level's landings that start the next level's chains (Au and Beck: 0.1 to 0.3)
LEVELS_MAX = 9  # maximum number of levels; rates below 1e-9 are not resolved
ACCEPTED = 0.44  # target share of accepted moves (Papaioannou et al. 2015, section 3.4)
WEIGHT = 0.6  # weight of the first move
_CERTAIN = 1.96  # half-width of a 95 % interval in standard deviations

Scores = Callable[[Sequence[int]], Sequence[float]]


@dataclass(frozen=True)
class Level:
    """Result of one level."""

    begins_at: float  # largest score of the level's landings; infinite for the first level
    ends_at: float  # largest score of the next level's landings; 0 for the last level
    share: float  # share of its landings at or below ``ends_at``
    variation: float  # coefficient of variation of this share, including correlation within the chains
    accepted: float  # share of accepted moves; 1 for the first level


@dataclass(frozen=True)
class Estimate:
    """Estimated rate of failures."""

    rate: float  # rate of failures; 0 if the last level had none
    low: float  # lower end of the 95 % interval, of a log-normal distribution
    high: float  # upper end of the interval; without a failure, the upper bound of the rate
    levels: tuple[Level, ...]  # one or more
    landings: int  # number of flown landings
    # seeds of the last level's failures, sampled from the distribution of failures
    failures: tuple[int, ...]


def estimate(scores: Scores, number: int, seed: int) -> Estimate:
    """Estimate the rate of failures.

    ``scores``: function that flies a batch of landings and returns their scores; ``number``: landings per
    level, a multiple of 1 / ``SHARE``; ``seed``: seed of this estimate; another seed gives an independent
    estimate.
    Raises ValueError: the number is not such a multiple, or is below 100.
    """
    length = round(1.0 / SHARE)
    if number < 100 or number % length:
        raise ValueError(f"{number} landings a level; a multiple of {length} from 100 on is needed")
    draw = np.random.default_rng(seed)
    seeds = [fresh(one) for one in _move_seeds(draw, number)]
    chains = np.array(scores(seeds), dtype=np.float64)[:, None]  # (chain, position)
    names = [[one] for one in seeds]
    levels: list[Level] = []
    begins_at, accepted, weight, landings = math.inf, 1.0, WEIGHT, number
    while True:
        share = float(np.mean(chains <= 0.0))
        order = np.argsort(chains, axis=None, kind="stable")
        last = share >= SHARE or len(levels) + 1 == LEVELS_MAX
        kept = order[: number // length]
        ends_at = 0.0 if last else float(chains.flat[kept[-1]])
        within = chains <= ends_at
        share = float(np.mean(within))
        levels.append(Level(begins_at, ends_at, share, _variation(within), accepted))
        flat = [one for chain in names for one in chain]
        if last or share == 1.0:
            failures = tuple(dict.fromkeys(flat[k] for k in np.flatnonzero(chains <= 0.0)))
            return _estimate(levels, landings, failures, number)
        begins_at = ends_at
        starts = [flat[k] for k in kept]
        chains, names, accepted, weight = _chains(
            scores, starts, chains.flat[kept].tolist(), begins_at, length, weight, draw
        )
        landings += number - len(starts)


def _chains(
    scores: Scores,
    starts: Sequence[int],
    start_scores: Sequence[float],
    most: float,
    length: int,
    weight: float,
    draw: np.random.Generator,
) -> tuple[np.ndarray, list[list[int]], float, float]:
    """Extend chains from each start, all together; return scores, seeds, accepted share and final weight."""
    states, state_scores = list(starts), list(start_scores)
    columns, names, accepted = [list(state_scores)], [[one] for one in states], 0
    for step in range(1, length):
        move_seeds = _move_seeds(draw, len(states))
        wanted = [moved(state, one, weight) for state, one in zip(states, move_seeds, strict=True)]
        now = 0
        for k, (seed, score) in enumerate(zip(wanted, scores(wanted), strict=True)):
            if score <= most:
                states[k], state_scores[k], now = seed, score, now + 1
            names[k].append(states[k])
        columns.append(list(state_scores))
        accepted += now
        weight = min(0.99, max(0.02, weight * math.exp((now / len(states) - ACCEPTED) / math.sqrt(step))))
    return np.array(columns).T, names, accepted / (len(states) * (length - 1)), weight


def _move_seeds(draw: np.random.Generator, number: int) -> list[int]:
    return [int(one) for one in draw.integers(1, MOVE_SEED_MAX, number)]


def _variation(within: np.ndarray) -> float:
    """Return the coefficient of variation of the share inside (Au and Beck 2001, eq. 29)."""
    chains, length = within.shape
    share = float(np.mean(within))
    if not 0.0 < share < 1.0:
        return 0.0
    spread = share * (1.0 - share)
    numbers = within.astype(np.float64)
    correlation = 0.0
    for lag in range(1, length):
        together = float(np.mean(numbers[:, :-lag] * numbers[:, lag:])) - share * share
        correlation += 2.0 * (1.0 - lag / length) * together / spread
    return math.sqrt((1.0 - share) / (share * chains * length) * max(1.0, 1.0 + correlation))


def _estimate(levels: list[Level], landings: int, failures: tuple[int, ...], number: int) -> Estimate:
    rate = math.prod(level.share for level in levels)
    if rate == 0.0:  # no failure in the last level: 95 % bound from the rule of three
        bound = math.prod(level.share for level in levels[:-1]) * 3.0 / number
        return Estimate(0.0, 0.0, bound, tuple(levels), landings, failures)
    spread = math.sqrt(math.log1p(math.fsum(level.variation**2 for level in levels)))
    factor = math.exp(_CERTAIN * spread)
    return Estimate(rate, rate / factor, min(1.0, rate * factor), tuple(levels), landings, failures)


class Event(Enum):
    """The failure whose rate is estimated."""

    VIOLATION = "violation"
    MISS = "miss"


def score(event: Event, row: Row, pad_radius_m: float) -> float:
    """Return the distance of a landing from the failure, m; 0 for a failure or an unknown result.

    ``violation``: lowest h outside the pad minus the limit of a violation. ``miss``: distance of the touch
    from the pad's edge; 0 for a touch beyond it, a crash, or an undeclared miss.

    ``event``: the failure; ``row``: row of the landing.
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
    """Definition of an estimate. Raises ConfigError: the scenario is a team."""

    # scenario with its filter; ``runs``: landings per level; ``first_seed``: seed of the estimate
    plan: Plan
    event: Event  # the failure

    def __post_init__(self) -> None:
        if not self.plan.scenario.is_alone:
            raise ConfigError(
                f"{self.plan.scenario_name}: found a team, allowed: the scenario of one vehicle; "
                "`flightstack campaign` flies teams"
            )


def fly(wanted: Rare, folder: Path, *, workers: int, on_row: OnRow) -> dict[str, Any]:
    """Fly the missing landings; return the result, which is also written to the folder.

    ``on_row``: called with each row, including rows of earlier calls.
    Raises RowsError: the folder has other content, or is in use; ValueError: a number of landings that levels
    cannot have; WorkersError: no worker can be kept running; RuntimeError: a landing could not be flown.
    """
    plan, scenario = wanted.plan, wanted.plan.first
    folder.mkdir(parents=True, exist_ok=True)
    with alone(folder), of_file(folder):
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
    """Return the ``--json`` output, and write the seeds of failures to files."""
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
