"""Flies a fleet once for all tests of its log; the tests share a worker."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pytest

from logs.reader.flight import load_fleet
from logs.verdict.verdict import FleetVerdict
from tests.fleet_log import fly_fleet, near


@dataclass
class FlownFleet:
    """The log of a fleet, and the campaign's verdict on the same flight."""

    log: Path
    verdict: FleetVerdict

    @cached_property
    def read(self):
        return load_fleet(self.log)


@pytest.fixture(scope="session")
def fleet(tmp_path_factory):
    """Three vehicles above three robots; two wait for the right of way; 10 % of the messages are lost."""
    log = tmp_path_factory.mktemp("fleet") / "flight.mcap"
    with pytest.MonkeyPatch.context() as patch:
        return FlownFleet(log, fly_fleet(log, near(), 1, patch))
