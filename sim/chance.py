"""Random numbers of a landing: streams from a seed, and seeds that shift another seed's numbers a little.

A seed below 2^64 is the plain seed of one landing. A longer one is a list of moves. The bits above the lowest
64 hold one move in each 64 bits: a 56-bit seed of a fresh stream and its 8-bit weight w. The normal numbers
of a stream are then

    z = w_m z_m + sqrt(1 - w_m^2) (w_(m-1) z_(m-1) + sqrt(1 - w_(m-1)^2) ( ... ))

They are standard normal for all weights, and close to the numbers before the move if its weight is small.
These are the moves of preconditioned Crank-Nicolson, with which Papaioannou et al. (2015,
doi:10.1016/j.probengmech.2015.06.006) run subset simulation. Other distributions are transformed from normal
numbers. So one number, the seed, reproduces each landing that moves lead to.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

_WORD_BITS, _WEIGHT_BITS = 64, 8
_WORD, _WEIGHTS = (1 << _WORD_BITS) - 1, 1 << _WEIGHT_BITS
MOVE_SEED_MAX = (1 << (_WORD_BITS - _WEIGHT_BITS)) - 1
MOVES_MAX = 200  # maximum moves of a seed; Python reads numbers of up to 4,300 digits


class Chance(Protocol):
    """The methods of numpy's ``Generator`` that the simulator uses."""

    def standard_normal(self, size: Any = None) -> Any:
        """Return standard normal numbers."""

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Return numbers that are uniform between ``low`` and ``high``."""

    def random(self, size: Any = None) -> Any:
        """Return numbers that are uniform between 0 and 1."""

    def exponential(self, scale: float = 1.0) -> Any:
        """Return one number of the exponential distribution with the mean ``scale``."""

    def integers(self, low: Any) -> Any:
        """Return integers from 0 to ``low`` - 1."""

    def permutation(self, x: int) -> Any:
        """Return the integers from 0 to ``x`` - 1 in random order."""

    def choice(self, a: int, *, p: Any) -> Any:
        """Return an integer from 0 to ``a`` - 1, drawn with the probabilities ``p``."""

    def spawn(self, n_children: int) -> Sequence[Chance]:
        """Return streams that are independent of this one and of each other."""


def stream(seed: int, purpose: str) -> Chance:
    """Return the random stream of one purpose; streams of different purposes are independent.

    ``seed``: seed of the run, with or without moves; ``purpose``: name of the stream.
    """

    def plain(one: int) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence([one & _WORD, zlib.crc32(purpose.encode())]))

    if seed <= _WORD:
        return plain(seed)
    parts, kept = [], 1.0
    for word in reversed(_words(seed)):
        weight = ((word & (_WEIGHTS - 1)) + 1) / _WEIGHTS
        parts.append((kept * weight, plain(word >> _WEIGHT_BITS)))
        kept *= math.sqrt(1.0 - weight * weight)
    return Moved(parts)


def fresh(move_seed: int) -> int:
    """Return a seed with one move, the first.

    ``move_seed``: 1 to ``MOVE_SEED_MAX``.
    Raises ValueError: ``move_seed`` is outside this range.
    """
    return moved(0, move_seed, 1.0)


def moved(seed: int, move_seed: int, weight: float) -> int:
    """Return a seed whose random numbers are those of ``seed``, changed by one more move.

    ``seed``: result of ``fresh`` or ``moved``, or 0 with a weight of 1; ``move_seed``: 1 to
    ``MOVE_SEED_MAX``; ``weight``: weight of the move, above 0, at most 1, rounded to 1/256; 1 drops earlier
    moves.
    Raises ValueError: a number is outside its range.
    """
    if not 1 <= move_seed <= MOVE_SEED_MAX:
        raise ValueError(f"seed of a move is {move_seed}; 1 to 2^56 - 1 is allowed")
    if not 0.0 < weight <= 1.0:
        raise ValueError(f"weight of a move is {weight:g}; above 0 and at most 1 is allowed")
    word = move_seed << _WEIGHT_BITS | max(1, round(weight * _WEIGHTS)) - 1
    if weight == 1.0:
        return word << _WORD_BITS
    moves = -(-seed.bit_length() // _WORD_BITS) - 1
    if moves < 1:
        raise ValueError(f"seed {seed} has no moves; begin with `fresh`")
    if moves >= MOVES_MAX:
        raise ValueError(f"the seed has {moves} moves already; {MOVES_MAX} are allowed")
    return seed | word << _WORD_BITS * (moves + 1)


def member(seed: int, number: int) -> int:
    """Return the seed of one member of a team; the first member has the seed of the team.

    A member's random numbers do not depend on the size of the team. The member's seed has the same moves as
    the team's, with the same weights.

    ``seed``: seed of the team, with or without moves; ``number``: number of the member, from 1.
    Raises ValueError: the number is below 1.
    """
    if number < 1:
        raise ValueError(f"number of a member is {number}; they are counted from 1")
    if number == 1:
        return seed

    def other(one: int) -> int:
        mixed = np.random.SeedSequence([one & _WORD, zlib.crc32(b"member"), number])
        return int(mixed.generate_state(1, np.uint64)[0])

    if seed <= _WORD:
        return other(seed)
    theirs = 0
    for place, word in enumerate(_words(seed), 1):
        move_seed = other(word >> _WEIGHT_BITS) % MOVE_SEED_MAX + 1
        theirs |= (move_seed << _WEIGHT_BITS | word & (_WEIGHTS - 1)) << _WORD_BITS * place
    return theirs


def name(seed: int) -> str:
    """Return a short text for titles and folders: the seed, or the last move's seed and number of moves."""
    if seed <= _WORD:
        return str(seed)
    words = _words(seed)
    return f"{words[-1] >> _WEIGHT_BITS}-moves{len(words)}"


def _words(seed: int) -> list[int]:
    """Return the moves of a seed, the first one first."""
    words = []
    while seed := seed >> _WORD_BITS:
        words.append(seed & _WORD)
    return words


def _below(normal: Any) -> Any:
    """Return the probability that a standard normal number is smaller."""
    from scipy.special import ndtr  # a late import: most processes have plain seeds and do not need scipy

    return ndtr(normal)


class Moved:
    """Random stream of a seed with moves.

    ``parts``: factor and stream of each move; the sum of the squared factors is 1.
    """

    def __init__(self, parts: Sequence[tuple[float, np.random.Generator]]) -> None:
        self._parts = parts

    def standard_normal(self, size: int | Sequence[int] | None = None) -> Any:
        """Return standard normal numbers."""
        (share, first), *others = self._parts
        total = share * first.standard_normal(size)
        for share, part in others:
            total = total + share * part.standard_normal(size)
        return total

    def random(self, size: int | Sequence[int] | None = None) -> Any:
        """Return numbers that are uniform between 0 and 1."""
        return _below(self.standard_normal(size))

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: int | None = None) -> Any:
        """Return numbers that are uniform between ``low`` and ``high``."""
        return low + (high - low) * self.random(size)

    def exponential(self, scale: float = 1.0) -> Any:
        """Return one number of the exponential distribution with the mean ``scale``."""
        return -scale * math.log(_below(-self.standard_normal()))

    def integers(self, low: Any) -> Any:
        """Return integers from 0 to ``low`` - 1."""
        shape = np.shape(low)
        drawn = np.floor(self.random(shape or None) * np.asarray(low)).astype(np.int64)
        return np.minimum(drawn, np.asarray(low) - 1)

    def permutation(self, x: int) -> Any:
        """Return the integers from 0 to ``x`` - 1 in random order."""
        return np.argsort(self.standard_normal(x))

    def choice(self, a: int, *, p: Any) -> Any:
        """Return an integer from 0 to ``a`` - 1, drawn with the probabilities ``p``."""
        return min(int(np.searchsorted(np.cumsum(p), self.random(), side="right")), a - 1)

    def spawn(self, n_children: int) -> Sequence[Chance]:
        """Return streams that are independent of this one and of each other."""
        shares, children = [s for s, _ in self._parts], [part.spawn(n_children) for _, part in self._parts]
        return [Moved(list(zip(shares, each, strict=True))) for each in zip(*children, strict=True)]
