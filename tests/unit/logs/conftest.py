"""Flies a fleet once; all tests of its log run in the same worker process."""

import pytest

from tests.fleet_log import fly_fleet


@pytest.fixture(scope="session")
def fleet(tmp_path_factory):
    """Return a flight of three vehicles with three robots; two wait, and 10 % of the messages are lost."""
    return fly_fleet(tmp_path_factory.mktemp("fleet"))
