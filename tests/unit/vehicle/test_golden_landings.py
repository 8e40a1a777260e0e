"""Tests that scenarios, filters, variants and faults still give the landings stored in ``tests/golden``."""

import json

import pytest

from tests.golden.landings import CASES, FILE, differences

pytestmark = pytest.mark.slow
STORED = json.loads(FILE.read_text())


@pytest.mark.parametrize("name", CASES)
def test_a_landing_is_flown_as_it_was(name):
    found = json.loads(json.dumps(CASES[name]()))
    different = differences(STORED.get(name), found)
    assert different == [], "if this is meant: python -m tests.golden.landings"


def test_nothing_else_is_stored():
    assert set(STORED) == set(CASES)
