"""docs/how_it_works/vehicle.md agrees with the simulator: fresh tables, all figures exist."""

import re

import pytest

from tests.benchmarks.vehicle.figures import DOCS, PAGE, written_tables
from tests.benchmarks.vehicle.tables import COMPARISONS, tables

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("vehicle docs")]  # one worker computes the tables
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
MAKE_ANEW = "run: python -m tests.benchmarks vehicle_figures"
FIGURE_MAX_BYTES = 150_000


@pytest.fixture(scope="module")
def fresh():
    return tables()


def test_every_table_is_in_the_page(fresh):
    assert set(written_tables()) == set(fresh), MAKE_ANEW


@pytest.mark.parametrize("name", ["parameters", "constants", "pid"])
def test_parameters_are_those_of_the_simulator(fresh, name):
    assert written_tables()[name] == fresh[name], MAKE_ANEW


@pytest.mark.parametrize("name", COMPARISONS)
def test_comparisons_are_those_of_a_fresh_run(fresh, name):
    written, made = written_tables()[name].splitlines(), fresh[name].splitlines()
    assert len(written) == len(made) > 3, MAKE_ANEW
    for old, new in zip(written, made, strict=True):
        assert NUMBER.sub("#", old) == NUMBER.sub("#", new), MAKE_ANEW
        for a, b in zip(NUMBER.findall(old), NUMBER.findall(new), strict=True):
            digit = 10.0 ** -len(a.partition(".")[2])  # other processors may round the last digit differently
            assert abs(float(a) - float(b)) < 1.5 * digit, (old, new, MAKE_ANEW)


@pytest.mark.parametrize(
    ("name", "percent"), [("roll", 8), ("velocity", 10), ("yaw", 9), ("touchdown", 2), ("supervisor", 3)]
)
def test_the_simulator_agrees_with_theory(fresh, name, percent):
    deviations = [float(d) for d in re.findall(r"\| ([-+][\d.]+) % \|", fresh[name])]
    assert len(deviations) == len(fresh[name].splitlines()) - 2
    assert max(map(abs, deviations)) < percent


def test_figures_are_there_small_and_all_shown():
    shown = set(re.findall(r"\]\(\.\./figures/(vehicle_\w+\.svg)\)", PAGE.read_text()))
    files = {path.name: path for path in (DOCS / "figures").glob("vehicle_*")}
    assert shown == set(files)
    for path in files.values():
        text = path.read_text()
        assert text.startswith("<?xml")
        assert text.rstrip().endswith("</svg>")
        assert 10_000 < len(text.encode()) < FIGURE_MAX_BYTES, path
