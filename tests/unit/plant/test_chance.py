"""Seeds with moves: their chance is standard again, near the one before, and a plain seed's is numpy's."""

import math
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.chance import MOVE_SEED_MAX, MOVES_MAX, fresh, moved, name, stream

N = 40_000


def walk(weight, moves, begin=7):
    seed = fresh(begin)
    for n in range(moves):
        seed = moved(seed, 1000 + n, weight)
    return seed


def test_a_plain_seed_is_numpys_generator():
    mine, plain = stream(5, "wind"), np.random.default_rng(np.random.SeedSequence([5, zlib.crc32(b"wind")]))
    assert np.array_equal(mine.standard_normal(100), plain.standard_normal(100))
    assert mine.uniform(1.0, 2.0) == plain.uniform(1.0, 2.0)


@pytest.mark.parametrize("moves", [0, 1, 9])
@pytest.mark.parametrize("weight", [0.05, 0.5])
def test_each_distribution_stays_itself_whatever_the_moves(weight, moves):
    from scipy import stats  # half a second, which each worker need not take

    seed = walk(weight, moves)
    assert stats.kstest(stream(seed, "a").standard_normal(N), "norm").pvalue > 1e-3
    assert stats.kstest(stream(seed, "b").random(N), "uniform").pvalue > 1e-3
    assert stats.kstest(stream(seed, "c").uniform(-2.0, 4.0, N), "uniform", (-2.0, 6.0)).pvalue > 1e-3
    waits = stream(seed, "d")
    assert stats.kstest([waits.exponential(3.0) for _ in range(2000)], "expon", (0.0, 3.0)).pvalue > 1e-3
    dice = stream(seed, "e")
    counts = np.bincount([int(dice.integers(6)) for _ in range(6000)], minlength=6)
    assert stats.chisquare(counts).pvalue > 1e-3
    rows = [dice.integers((2, 5)).tolist() for _ in range(500)]
    assert {a for a, _ in rows} == {0, 1}
    assert {b for _, b in rows} == set(range(5))
    picked = np.bincount([dice.choice(3, p=(0.5, 0.3, 0.2)) for _ in range(3000)], minlength=3)
    assert stats.chisquare(picked, (1500, 900, 600)).pvalue > 1e-3
    one, two = (child.standard_normal(N) for child in dice.spawn(2))
    assert stats.kstest(one, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.02
    assert sorted(stream(seed, "f").permutation(50).tolist()) == list(range(50))


@pytest.mark.parametrize("weight", [0.125, 0.5])
def test_a_move_is_as_far_as_its_weight_says(weight):
    before, after = walk(weight, 3), walk(weight, 4)
    a, b = stream(before, "x").standard_normal(N), stream(after, "x").standard_normal(N)
    assert np.corrcoef(a, b)[0, 1] == pytest.approx(math.sqrt(1.0 - weight**2), abs=0.02)


@given(st.lists(st.tuples(st.integers(1, MOVE_SEED_MAX), st.integers(1, 255)), max_size=6))
def test_the_same_number_is_the_same_chance(moves):
    seed = fresh(3)
    for move_seed, w in moves:
        seed = moved(seed, move_seed, w / 256)
    assert int(str(seed)) == seed
    assert len(name(seed)) < 30
    numbers = stream(seed, "x").standard_normal(3)
    # as the formula has it, one move after the other
    z = np.random.default_rng(np.random.SeedSequence([3, zlib.crc32(b"x")])).standard_normal(3)
    for move_seed, w in moves:
        fresh_z = np.random.default_rng(
            np.random.SeedSequence([move_seed, zlib.crc32(b"x")])
        ).standard_normal(3)
        z = w / 256 * fresh_z + math.sqrt(1.0 - (w / 256) ** 2) * z
    assert numbers == pytest.approx(z, abs=1e-12)


def test_what_is_not_allowed_is_refused():
    for bad in (0, MOVE_SEED_MAX + 1):
        with pytest.raises(ValueError, match="seed of a move"):
            fresh(bad)
    for weight in (0.0, -0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="weight"):
            moved(fresh(1), 2, weight)
    with pytest.raises(ValueError, match="has no moves"):
        moved(17, 2, 0.5)
    seed = walk(0.5, MOVES_MAX - 1)
    with pytest.raises(ValueError, match="moves already"):
        moved(seed, 5, 0.5)
    assert moved(seed, 5, 1.0) == fresh(5)
