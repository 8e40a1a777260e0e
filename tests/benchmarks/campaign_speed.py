"""Landings of campaigns as a multiple of real time on one core, and where the time goes; teams likewise."""

from __future__ import annotations

import functools
import gc
import statistics
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from bridge.mavlink.client.link import VehicleLink
from flightstack.common.pacing import quiet_garbage_collector
from flightstack.compiled.program import CompiledFilter
from flightstack.core.controller import Controller
from flightstack.core.fleet.member import FleetMember
from flightstack.onboard.runner import LinkedVehicle
from sim.autopilot.autopilot import Autopilot
from sim.runners import landing
from sim.runners.companion import Companion
from sim.runners.landing import land_team, warm_up
from sim.runners.landing_wire import Inlet
from sim.runners.notes import Notes
from sim.runners.robot import DirectTarget
from sim.runners.room import Pairs, Words
from sim.runners.stretch import stretch
from sim.runners.stretch.stretch import Stretch
from sim.scenarios.team import TeamScenario, load
from sim.vehicle import vehicle
from sim.vehicle.air import Air
from sim.vehicle.vehicle import VehicleSim

LANDINGS = 8
ASKED = 200.0
TICKS, STRETCH, PHYSICS, VEHICLE, CONTROLLER, OSQP, ROBOT, AUTOPILOT, LINK, WIRE, NOTES, SET_UP = (
    "whole ticks, compiled", "stretches of these: begun, ended, noted",
    "physics and firmware, compiled", "vehicle in Python: events, true and estimated state",
    "controller but for OSQP", "OSQP with its data", "robot", "autopilot: telemetry, commands, modes",
    "companion's link", "wire", "notes and verdict", "setting up",
)  # fmt: skip
HEARS, WAY, ROWS, PROGRAM, TELLS, AROUND = (
    "fleet: words heard", "fleet: right of way", "fleet: rows of neighbours",
    "fleet: program with them, OSQP in it", "fleet: own word", "team: words passed on, jets, pairs",
)  # fmt: skip
REST = "rest: lockstep"
PARTS: tuple[tuple[Any, str, str], ...] = (
    (stretch, "fly_ticks", TICKS),
    (Stretch, "fly", STRETCH),
    (DirectTarget, "ahead", ROBOT),
    (vehicle, "fly", PHYSICS),
    (VehicleSim, "advance", VEHICLE),
    (VehicleSim, "truth", VEHICLE),
    (VehicleSim, "estimate", VEHICLE),
    (VehicleSim, "set_deck", VEHICLE),
    (Controller, "step", CONTROLLER),
    (CompiledFilter, "solve", OSQP),
    (DirectTarget, "take", ROBOT),
    (DirectTarget, "samples", ROBOT),
    (Autopilot, "telemetry", AUTOPILOT),
    (Autopilot, "handle", AUTOPILOT),
    (Autopilot, "control", AUTOPILOT),
    (VehicleLink, "poll", LINK),
    (LinkedVehicle, "read", LINK),
    (LinkedVehicle, "answer", LINK),
    (Inlet, "send", WIRE),
    (Notes, "step", NOTES),
    (Notes, "truth", NOTES),
    (Notes, "seen", NOTES),
    (landing, "judge_truth", NOTES),
    (Companion, "__init__", SET_UP),
    (FleetMember, "take", HEARS),
    (FleetMember, "way", WAY),
    (FleetMember, "rows", ROWS),
    (FleetMember, "aside", ROWS),
    (FleetMember, "solve", PROGRAM),
    (FleetMember, "word", TELLS),
    (Words, "__call__", AROUND),
    (Air, "blow", AROUND),
    (Pairs, "end", AROUND),
)


class Meter:
    """Time spent in each part but for the parts called from there, ns; wall time, for its clock is cheap."""

    def __init__(self) -> None:
        self.spent_ns: Counter[str] = Counter()
        self._inner_ns = [0]  # of the calls that are under way

    def wrap(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        """The same function, measured."""
        clock, inner_ns, spent_ns = time.perf_counter_ns, self._inner_ns, self.spent_ns

        @functools.wraps(function)
        def measured(*args: Any, **kwargs: Any) -> Any:
            inner_ns.append(0)
            began_ns = clock()
            try:
                return function(*args, **kwargs)
            finally:
                whole_ns = clock() - began_ns
                spent_ns[part] += whole_ns - inner_ns.pop()
                inner_ns[-1] += whole_ns

        return measured

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Measure every part meanwhile."""
        with ExitStack() as stack:
            for owner, name, part in PARTS:
                stack.enter_context(patch.object(owner, name, self.wrap(getattr(owner, name), part)))
            yield


def flown_s(scenario: TeamScenario, seed: int) -> float:
    """Fly a landing, or those of a team; simulated time of all its vehicles."""
    return sum(each.simulated_s for each in land_team(scenario, seed).landings)


def us_per_tick(scenario: TeamScenario, seed: int) -> dict[str, float]:
    """What each part of one landing, or of a team's, costs a tick of a vehicle, us."""
    meter = Meter()
    with meter.watching():
        began_ns = time.perf_counter_ns()
        ticks = flown_s(scenario, seed) * scenario.member[0].onboard.loop.rate_hz
        whole_ns = time.perf_counter_ns() - began_ns
    meter.spent_ns[REST] = whole_ns - meter.spent_ns.total()
    return {part: spent_ns / ticks / 1e3 for part, spent_ns in meter.spent_ns.items()}


def main(scenario_name: str = "lab") -> None:
    """Fly, measure, print; arguments are the scenario, and a filter if it is not the scenario's own."""
    if len(sys.argv) > 1:
        scenario_name = sys.argv[1]
    scenario = load(scenario_name)
    if len(sys.argv) > 2:
        scenario = scenario.with_filter(sys.argv[2])
        scenario_name += f", {sys.argv[2]}"
    warm_up(scenario)
    flown_s(scenario, 0)
    quiet_garbage_collector()
    factors, spent = [], []
    for seed in range(LANDINGS):
        began_s = time.process_time()
        simulated_s = flown_s(scenario, seed)
        spent.append(time.process_time() - began_s)
        factors.append(simulated_s / spent[-1])
        gc.collect()
    print(
        f"{scenario_name}: {statistics.median(factors):.0f} x real time on one core (asked {ASKED:.0f}), "
        f"{min(factors):.0f} to {max(factors):.0f} in {LANDINGS} flights of one seed, vehicle by vehicle; "
        f"{statistics.median(spent):.3f} s of processor time a flight"
    )
    rows = [us_per_tick(scenario, seed) for seed in range(LANDINGS)]
    parts = {part: statistics.median(row[part] for row in rows) for part in rows[0]}
    whole = sum(parts.values())
    period_us = 1e6 / scenario.member[0].onboard.loop.rate_hz
    print(
        f"a tick under the meter, which makes short calls look longer: {whole:.0f} us of "
        f"{period_us:.0f}; {ASKED:.0f} x would be {period_us / ASKED:.0f}"
    )
    for part, cost in sorted(parts.items(), key=lambda item: -item[1]):
        print(f"  {cost:6.1f} us {100.0 * cost / whole:5.1f} %  {part}")
