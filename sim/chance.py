"""Random numbers of a landing: streams of a seed, and seeds that move the numbers of another a little.

A seed below 2^64 is one landing's chance. A longer one is a list of moves, one in each 64 bits above
the lowest: 56 bits are the seed of a fresh stream, 8 its weight w. The normal numbers of a stream are then

    z = w_m z_m + sqrt(1 - w_m^2) (w_(m-1) z_(m-1) + sqrt(1 - w_(m-1)^2) ( ... ))

which are standard normal again, whatever the weights, and near those before the move where its weight is
small: moves of preconditioned Crank-Nicolson, with which Papaioannou et al. (2015,
doi:10.1016/j.probengmech.2015.06.006) run subset simulation. What is not normal is made from normal numbers.
So each landing that moves lead to is flown again from one number.
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
MOVES_MAX = 200  # of a seed; a longer one is refused: Python reads numbers of up to 4,300 digits


class Chance(Protocol):
    """The part of numpy's ``Generator`` that the simulator draws with."""

    def standard_normal(self, size: Any = None) -> Any:
        """Standard normal numbers."""

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Numbers between two."""

    def random(self, size: Any = None) -> Any:
        """Numbers between 0 and 1."""

    def exponential(self, scale: float = 1.0) -> Any:
        """One number of the exponential distribution of this mean."""

    def integers(self, low: Any) -> Any:
        """Whole numbers from 0 to below ``low``."""

    def permutation(self, x: int) -> Any:
        """The numbers from 0 to below ``x`` in any order."""

    def choice(self, a: int, *, p: Any) -> Any:
        """A number from 0 to below ``a``, with the probabilities ``p``."""

    def spawn(self, n_children: int) -> Sequence[Chance]:
        """Streams that are independent of this one and of each other."""


def stream(seed: int, purpose: str) -> Chance:
    """Random stream of one purpose; streams of different purposes are independent of each other.

    ``seed``: of the run, also one with moves; ``purpose``: name of the stream.
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
    """Seed of a chance that begins a line of moves.

    ``move_seed``: 1 to ``MOVE_SEED_MAX``.
    Raises ValueError: another one.
    """
    return moved(0, move_seed, 1.0)


def moved(seed: int, move_seed: int, weight: float) -> int:
    """Seed whose random numbers are those of another seed, moved.

    ``seed``: by ``fresh`` or ``moved``; 0 with a weight of 1, which removes it; ``move_seed``: 1 to
    ``MOVE_SEED_MAX``; ``weight``: of the move, above 0 and at most 1, rounded to 1/256.
    Raises ValueError: a number is not allowed.
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
    """Seed of one member of a team, of the same kind as the team's; the first one has the team's own.

    What a member draws does not depend on how many others there are. Moves of the team's seed are moves of
    the member's, with the same weights.

    ``seed``: of the team, also one with moves; ``number``: of the member, from 1.
    Raises ValueError: a number below 1.
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
    """Short text for titles and folders: the seed, or the seed of the last move and the number of moves."""
    if seed <= _WORD:
        return str(seed)
    words = _words(seed)
    return f"{words[-1] >> _WEIGHT_BITS}-moves{len(words)}"


def _words(seed: int) -> list[int]:
    """The moves, first one first."""
    words = []
    while seed := seed >> _WORD_BITS:
        words.append(seed & _WORD)
    return words


def _below(normal: Any) -> Any:
    """Probability of a smaller normal number."""
    from scipy.special import ndtr  # plain seeds, which most processes have, do not pay for it

    return ndtr(normal)


class Moved:
    """A stream of a seed with moves.

    ``parts``: share of each move's normal numbers, and their stream; the squares of the shares sum up to 1.
    """

    def __init__(self, parts: Sequence[tuple[float, np.random.Generator]]) -> None:
        self._parts = parts

    def standard_normal(self, size: int | Sequence[int] | None = None) -> Any:
        """Standard normal numbers."""
        (share, first), *others = self._parts
        total = share * first.standard_normal(size)
        for share, part in others:
            total = total + share * part.standard_normal(size)
        return total

    def random(self, size: int | Sequence[int] | None = None) -> Any:
        """Numbers between 0 and 1."""
        return _below(self.standard_normal(size))

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: int | None = None) -> Any:
        """Numbers between two."""
        return low + (high - low) * self.random(size)

    def exponential(self, scale: float = 1.0) -> Any:
        """One number of the exponential distribution of this mean."""
        return -scale * math.log(_below(-self.standard_normal()))

    def integers(self, low: Any) -> Any:
        """Whole numbers from 0 to below ``low``."""
        shape = np.shape(low)
        drawn = np.floor(self.random(shape or None) * np.asarray(low)).astype(np.int64)
        return np.minimum(drawn, np.asarray(low) - 1)

    def permutation(self, x: int) -> Any:
        """The numbers from 0 to below ``x`` in any order."""
        return np.argsort(self.standard_normal(x))

    def choice(self, a: int, *, p: Any) -> Any:
        """A number from 0 to below ``a``, with the probabilities ``p``."""
        return min(int(np.searchsorted(np.cumsum(p), self.random(), side="right")), a - 1)

    def spawn(self, n_children: int) -> Sequence[Chance]:
        """Streams that are independent of this one and of each other."""
        shares, children = [s for s, _ in self._parts], [part.spawn(n_children) for _, part in self._parts]
        return [Moved(list(zip(shares, each, strict=True))) for each in zip(*children, strict=True)]
