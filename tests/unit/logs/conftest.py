"""A fleet that was flown once, for all tests of what is done with its log; they share a worker."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from logs.verdict.fleet import FleetVerdict
from sim.scenarios.team import load
from tests.fleet_log import fly_fleet


@dataclass(frozen=True)
class FlownFleet:
    """The log, and what the campaign judges of the same flight."""

    log: Path
    verdict: FleetVerdict


@pytest.fixture(scope="session")
def fleet(tmp_path_factory):
    """Three vehicles over three robots whose ways cross."""
    log = tmp_path_factory.mktemp("fleet") / "flight.mcap"
    with pytest.MonkeyPatch.context() as patch:
        return FlownFleet(log, fly_fleet(log, load("fleet_3"), 1, patch))
