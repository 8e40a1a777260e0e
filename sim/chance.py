"""Random numbers of a landing: the seed gives one stream for each purpose."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Return the random stream of one purpose, independent of all others; ``seed``: seed of the run."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(purpose.encode())]))


def member(seed: int, number: int) -> int:
    """Return the seed of one member of a team; the first member has the seed of the team.

    The random numbers of a member do not depend on the size of the team.

    ``seed``: seed of the team; ``number``: number of the member, from 1.
    Raises ValueError: the number is below 1.
    """
    if number < 1:
        raise ValueError(f"number of a member is {number}; they are counted from 1")
    if number == 1:
        return seed
    mixed = np.random.SeedSequence([seed, zlib.crc32(b"member"), number])
    return int(mixed.generate_state(1, np.uint64)[0])
