"""Flies a fleet in lockstep, for the tests of fleet logs."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from logs.reader.flight import load_fleet
from logs.verdict.verdict import FleetVerdict, judge_fleet
from sim.scenarios.scenario import Scenario, load, text
from sim.scenarios.tables import ExchangeLink
from tests.integration.runs import fly

SEED = 1


def near() -> Scenario:
    """Return a team of three whose close pads let one vehicle land at a time; 10 % of messages are lost."""
    team = load("fleet_3")
    near = {"pad_distance_m": 1.5, "wait_distance_m": 1.6}
    members = (
        replace(m, onboard=replace(m.onboard, fleet=replace(m.onboard.fleet, **near))) for m in team.members
    )
    return replace(Scenario.of(members), exchange=ExchangeLink(delay_s=0.05, loss=0.1))


@dataclass
class FlownFleet:
    """The log of a fleet, the members' flights, and the verdict on the fleet."""

    log: Path

    @cached_property
    def read(self):
        return load_fleet(self.log)

    @cached_property
    def verdict(self) -> FleetVerdict:
        return judge_fleet(self.read)


def fly_fleet(folder: Path) -> FlownFleet:
    file = folder / "fleet_3.toml"
    file.write_text(text(near()))
    done = fly(folder / "run", str(file), SEED)
    assert done.code == 0, done.out + done.err
    return FlownFleet(folder / "run" / "flight.mcap")
