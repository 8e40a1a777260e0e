"""Subset simulation (Au and Beck 2001, doi:10.1016/S0266-8920(01)00019-4): rates too small to be counted.

A landing has a score that falls towards the failure and is 0 or less there. The landings of the first level
are drawn freely. Those with the lowest scores begin chains of moves (``sim.chance``) that do not exceed these
scores: they draw landings under the condition of being as bad as that, which are the next level. The rate is
the product of the levels' shares. The weight of the moves follows how many are accepted (Papaioannou et al.
2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim.chance import MOVE_SEED_MAX, fresh, moved

SHARE = 0.1  # of a level's landings that begin the next one's chains (Au and Beck: 0.1 to 0.3)
LEVELS_MAX = 9  # a rate below 1e-9 is not looked for
ACCEPTED = 0.44  # share of moves that the weight is led to (Papaioannou et al. 2015, section 3.4)
WEIGHT = 0.6  # of the first move
_CERTAIN = 1.96  # standard deviations of an interval of 95 %

Scores = Callable[[Sequence[int]], Sequence[float]]


@dataclass(frozen=True)
class Level:
    """One level."""

    begins_at: float  # score at or below which all its landings are; infinite for the first
    ends_at: float  # score at or below which the next one's are; 0 for the last
    share: float  # of its landings that are at or below ``ends_at``
    variation: float  # coefficient of variation of that share, correlation within the chains included
    accepted: float  # share of accepted moves; 1 for the first level


@dataclass(frozen=True)
class Estimate:
    """What was found."""

    rate: float  # of failures; 0 if the last level had none
    low: float  # lower end of the 95 % interval, of a log-normal distribution
    high: float  # upper end; if no failure was found, the upper bound of the rate
    levels: tuple[Level, ...]  # one or more
    landings: int  # number of flown landings
    # seeds of the last level's failures, drawn with the probabilities that failures have
    failures: tuple[int, ...]


def estimate(scores: Scores, number: int, seed: int) -> Estimate:
    """Estimate the rate of failures.

    ``scores``: flies landings, a batch at a time, and returns their scores; ``number``: of landings in a
    level, a multiple of 1 / ``SHARE``; ``seed``: of this estimate; another one makes another, independent
    estimate.
    Raises ValueError: the number is no such multiple, or below 100.
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
    """Chains from each start, all a step at a time: scores, seeds, share accepted, weight at the end."""
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
    """Coefficient of variation of the share that is within (Au and Beck 2001, eq. 29)."""
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
    if rate == 0.0:  # the last level alone found none: by its own landings, three would have been likely
        bound = math.prod(level.share for level in levels[:-1]) * 3.0 / number
        return Estimate(0.0, 0.0, bound, tuple(levels), landings, failures)
    spread = math.sqrt(math.log1p(math.fsum(level.variation**2 for level in levels)))
    factor = math.exp(_CERTAIN * spread)
    return Estimate(rate, rate / factor, min(1.0, rate * factor), tuple(levels), landings, failures)
