"""Flies the fault grid of a fleet: ``fleet_3`` with one fault at one moment in each flight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum

from flightstack.core.types import MemberStatus
from logs.verdict.verdict import FleetVerdict
from sim.campaign.rows import judge_landing
from sim.runners.landing import Exchange, land
from sim.runners.room import Words
from sim.scenarios.fault_spec import Fault, Kind, What
from sim.scenarios.scenario import Scenario, load

WHO, LIE_M = 2, 0.5
MOMENTS_S = {"crossing": 1.5, "approach to land": 3.6, "touchdown": 4.3}


class Way(StrEnum):
    """Faults that one of the three members can have; in the grid the second member fails."""

    KILLED = "process killed"
    SILENT = "radio silent"
    CUT = "network cut in two"
    LIES = "sends a position half a metre off"
    STOPS = "its robot stops suddenly"


def fly(way: Way, at_s: float, seed: int) -> FleetVerdict:
    """Fly one cell of the grid; return the verdict on the fleet."""
    team, exchange = broken(load("fleet_3"), seed, way, WHO, at_s)
    return judge_landing(land(team, seed, exchange=exchange))


def broken(team: Scenario, seed: int, way: Way, who: int, at_s: float) -> tuple[Scenario, Exchange]:
    """Return the team with a fault of member ``who`` from ``at_s`` on, and the exchange of its messages."""
    if way is Way.STOPS:
        team = _with_fault(team, who, Fault(What.ROBOT, Kind.STUCK, start_s=at_s))
    if way is Way.KILLED:  # the member's autopilot ends the flight by a fail-safe
        team = _with_fault(team, who, Fault(What.LINK_IN, Kind.OFF, start_s=at_s))
    words, from_tick = Words(team, seed), round(at_s * team.rate_hz)

    def tell(tick: int, messages: Sequence[MemberStatus | None]) -> Sequence[Sequence[MemberStatus]]:
        told, own = list(messages), messages[who - 1]
        if way is Way.LIES and tick >= from_tick and own is not None:
            x, y, z = own.position_enu_m
            told[who - 1] = own._replace(position_enu_m=(x, y + LIE_M, z))
        heard = words(tick, told)
        if tick < from_tick or way not in (Way.KILLED, Way.SILENT, Way.CUT):
            return heard
        if way is Way.CUT:
            heard[who - 1] = []
        return [[message for message in found if message.id != who] for found in heard]

    return team, tell


def _with_fault(team: Scenario, who: int, fault: Fault) -> Scenario:
    members = list(team.members)
    members[who - 1] = replace(members[who - 1], fault=(fault,))
    return Scenario.of(members)


SEED = 1
FLEET_HEAD = f"""
## A fleet

Each row is a flight of the three vehicles of `fleet_3` with seed {SEED}. In each flight the second vehicle
fails permanently at one time: {", ".join(f"{at_s:g} s ({moment})" for moment, at_s in MOMENTS_S.items())}.
Requirements: no two vehicles collide, none comes inside the [ellipsoid](../how_it_works/fleet.md) around
another one, and the other two land on their pads.

- If a process is killed, its autopilot's fail-safe immediately lands the vehicle, by chance on its robot.
- If a sent position jumps, the ellipsoid around it grows by the jump. So the other vehicles keep clear of
  the previous position, too. A vehicle whose pad is inside the ellipsoid may abort its landing.
- A position that is wrong from the start does not jump and cannot be detected.
- If a robot stops suddenly, its vehicle detects this in the odometry of the robot.

| fault of the second member | moment | outcomes of the members \
| least distance in the measure of the ellipsoid | least distance, m |
|---|---|---|--:|--:|
"""


WIRE_TEST = "tests/unit/onboard/test_fleet_wire.py"
NAMESAKES = (
    f"| two processes with one id | start, flight | the second process is refused, see `{WIRE_TEST}` "
    "(in a team within one process, messages have no senders) | - | - |"
)


def row(way: Way, moment: str, verdict: FleetVerdict) -> str:
    ends = ", ".join(end.value for end in verdict.outcomes)
    return f"| {way} | {moment} | {ends} | {verdict.ellipsoid_min:.2f} | {verdict.distance_min_m:.2f} |"


def section() -> str:
    """Fly all cells; return the fleet's section of the page."""
    cells = [row(way, moment, fly(way, at_s, SEED)) for way in Way for moment, at_s in MOMENTS_S.items()]
    return FLEET_HEAD + "\n".join([*cells, NAMESAKES]) + "\n"
