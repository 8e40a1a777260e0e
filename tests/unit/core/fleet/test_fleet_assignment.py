"""Vehicles and pads: the least sum of all permutations; equal sums."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.core.fleet.assignment import UNIT_M, assign

PLACE = st.tuples(*[st.floats(-20.0, 20.0)] * 2, st.floats(0.0, 3.0))
GRID = st.tuples(st.integers(-2, 2), st.integers(-2, 2), st.just(0)).map(lambda p: tuple(map(float, p)))


def units(start, pad):
    return round(math.hypot(pad[0] - start[0], pad[1] - start[1]) / UNIT_M)


def fleets(place):
    """As many starts as the number drawn, and up to two pads more."""
    return st.integers(1, 5).flatmap(
        lambda n: st.tuples(
            st.lists(place, min_size=n, max_size=n), st.lists(place, min_size=n, max_size=min(6, n + 2))
        )
    )


def by_trying(starts, pads):
    """The first in the order of preference of all assignments with the least sum."""
    every = list(itertools.permutations(range(len(pads)), len(starts)))
    sums = [sum(units(start, pads[k]) for start, k in zip(starts, each, strict=True)) for each in every]
    best = [each for each, total in zip(every, sums, strict=True) if total == min(sums)]
    return min(best, key=lambda each: [(k != own, k) for own, k in enumerate(each)])


@given(fleets(PLACE) | fleets(GRID))  # on a grid many sums are equal
def test_it_is_the_best_of_all_permutations(fleet):
    assert assign(*fleet) == by_trying(*fleet)


def test_equal_sums_leave_each_vehicle_its_own_pad():
    square = [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, -1.0, 0.0)]
    assert assign([(0.0, 0.0, 1.0)] * 3, square) == (0, 1, 2)
    assert assign([(0.0, 0.0, 1.0)], square[::-1]) == (0,)
    # its own pad, the third one, is far: then the lowest index
    assert (
        assign([(9.0, 9.0, 0.0), (9.0, -9.0, 0.0), (0.0, 0.0, 0.0)], [*square[:2], (-9.0, 0.0, 0.0)])[2] == 2
    )


@pytest.mark.parametrize(
    ("starts", "pads", "error"),
    [
        ([(0.0, 0.0, 0.0)] * 2, [(0.0, 0.0, 0.0)], "found 1 pads for 2 vehicles; each vehicle needs one"),
        ([(math.nan, 0.0, 0.0)], [(0.0, 0.0, 0.0)], r"found the place \(nan, 0.0, 0.0\) m; allowed"),
        ([(0.0, 0.0, 0.0)], [(0.0, 1e7, 0.0)], r"coordinates up to 1e\+06 m"),
    ],
)
def test_what_cannot_be_assigned_is_refused(starts, pads, error):
    with pytest.raises(ValueError, match=error):
        assign(starts, pads)
