"""A fleet that was flown once, for all tests of what is done with its log; they share a worker."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from logs.verdict.verdict import FleetVerdict
from tests.fleet_log import fly_fleet, near


@dataclass(frozen=True)
class FlownFleet:
    """The log, and what the campaign judges of the same flight."""

    log: Path
    verdict: FleetVerdict


@pytest.fixture(scope="session")
def fleet(tmp_path_factory):
    """Three vehicles over three robots; two wait for the one before, a tenth of the words is lost."""
    log = tmp_path_factory.mktemp("fleet") / "flight.mcap"
    with pytest.MonkeyPatch.context() as patch:
        return FlownFleet(log, fly_fleet(log, near(), 1, patch))
