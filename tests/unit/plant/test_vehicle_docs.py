"""Compares the tables of docs/how_it_works/vehicle.md with new results of the simulator."""

import re

import pytest

from tests.benchmarks.vehicle.tables import COMPARISONS, tables, written_tables

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("vehicle docs")]  # one worker computes the tables
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
MAKE_ANEW = "run: python -m tests.benchmarks vehicle_tables"


@pytest.fixture(scope="module")
def fresh():
    return tables()


def test_every_table_is_in_the_page(fresh):
    assert set(written_tables()) == set(fresh), MAKE_ANEW


@pytest.mark.parametrize("name", COMPARISONS)
def test_comparisons_are_those_of_a_fresh_run(fresh, name):
    written, made = written_tables()[name].splitlines(), fresh[name].splitlines()
    assert len(written) == len(made) > 3, MAKE_ANEW
    for old, new in zip(written, made, strict=True):
        assert NUMBER.sub("#", old) == NUMBER.sub("#", new), MAKE_ANEW
        for a, b in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
            digit = 10.0 ** -len(a.partition(".")[2])  # other processors may round the last digit differently
            assert abs(float(a) - float(b)) < 1.5 * digit, (old, new, MAKE_ANEW)


@pytest.mark.parametrize(("name", "percent"), [("roll", 8), ("velocity", 10), ("yaw", 9), ("touchdown", 2)])
def test_the_simulator_agrees_with_theory(fresh, name, percent):
    deviations = [float(d) for d in re.findall(r"\| ([-+][\d.]+) % \|", fresh[name])]
    assert len(deviations) == len(fresh[name].splitlines()) - 2
    assert max(map(abs, deviations)) < percent
