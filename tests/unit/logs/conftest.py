"""Flies a fleet once for all tests of its log; the tests share a worker."""

import pytest

from tests.fleet_log import fly_fleet


@pytest.fixture(scope="session")
def fleet(tmp_path_factory):
    """Three vehicles above three robots; two wait for the right of way; 10 % of the messages are lost."""
    return fly_fleet(tmp_path_factory.mktemp("fleet"))
