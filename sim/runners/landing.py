"""Seeded landings in one process without sockets, recorded and judged.

The code is the same as with separate processes; only the messages are passed directly, with the rounding of
the wire. A landing equals ``flightstack sitl --lockstep`` of the same scenario and seed to the last bit. A
single vehicle flies batches of ticks where possible.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from bridge.mavlink.client.link import COMPONENT_ID as COMPANION_ID
from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.profiles import OWN_SITL
from bridge.mavlink.server.server import COMPONENT_ID, SYSTEM_ID
from flightstack.common.hangup import Stop
from flightstack.common.pacing import Tick
from flightstack.compiled.jit import at_once, compiling
from flightstack.core.controller import Controller, Outputs
from flightstack.core.types import MemberStatus, Phase
from flightstack.onboard.leaving import Leaving
from flightstack.onboard.lockstep import VehicleTicks
from flightstack.onboard.runner import Runner, Taken, open_link
from logs.recorder.feed import Feed
from logs.schema import Names, member_name
from logs.schema.rows import FleetPairRow
from logs.verdict.truth import judge_truth
from logs.verdict.types import Verdict
from sim.autopilot.autopilot import Autopilot
from sim.clock import NS_PER_S, TickGrid
from sim.runners.batches import Batches, suited
from sim.runners.landing_wire import wires
from sim.runners.lockstep import Exchange, LockstepVehicle, fly_in_lockstep
from sim.runners.log import Notes, Seen
from sim.runners.robot import DirectTarget
from sim.runners.room import FleetEnd, Room, Words, warm_up_room
from sim.scenarios.scenario import Scenario, load
from sim.vehicle.vehicle import VehicleSim

OnStep = Callable[[Tick, Outputs], None]


class _Wires(VehicleTicks):
    """Inputs of a companion whose vehicle, robot and neighbours are in the same process."""

    def __init__(self, link: VehicleLink, rate_hz: int, target: DirectTarget) -> None:
        super().__init__(link, rate_hz)
        self.samples, self.landing_began = target.samples, target.landing_began
        self.neighbours: tuple[MemberStatus, ...] = ()  # messages of other vehicles since the last tick

    def statuses(self) -> tuple[MemberStatus, ...]:
        return self.neighbours


class Companion(Leaving, FleetEnd):
    """Replaces the onboard process; the vehicle's loop calls it instead of the wait for an answer.

    ``controller`` replaces the scenario's controller. ``on_step`` is called after every controller step.
    ``system_id``: MAVLink system id of the vehicle. ``target_seed``: seed of the robot; if None, ``seed`` is
    used.
    """

    robot_type: ClassVar[type[DirectTarget]] = DirectTarget
    log_type: ClassVar[type[Notes]] = Notes

    def __init__(
        self, scenario: Scenario, seed: int, on_step: OnStep | None = None, system_id: int = SYSTEM_ID,
        target_seed: int | None = None, *, controller: Controller | None = None,
    ) -> None:  # fmt: skip
        self._ends_s = scenario.duration_max_s
        super().__init__(self._ends_s)
        config = scenario.onboard
        rate_hz = config.loop.rate_hz
        self.name = member_name(system_id)  # name and namespace of the vehicle: cf1 for system id 1
        self.controller = controller or Controller(config)
        self.seed, self._on_step = seed, on_step
        self._stop = Stop()
        self._over = False
        self.tick = 0  # current tick of the fleet's vehicles
        self._grid = grid = TickGrid(rate_hz)
        ticks_max = grid.count(scenario.duration_max_s + config.retreat.abort_time_max_s + 10.0)
        assert ticks_max is not None  # every scenario has a time limit
        self.ticks_max = ticks_max  # maximum number of ticks of a flight
        self.target = target = self.robot_type(scenario, seed if target_seed is None else target_seed, grid)
        here, there = wires((system_id, COMPONENT_ID), (system_id, COMPANION_ID))
        self._link = open_link(config, there, system_id, OWN_SITL, lockstep=True)
        self.vehicle = vehicle = VehicleSim(scenario, seed)  # the simulated vehicle
        autopilot = Autopilot(vehicle, rate_hz, system_id=system_id)
        # message of the newest tick to the other vehicles; None: no message, or the flight is over
        self._message: MemberStatus | None = None
        # longest wait and current wait for the right of way, ticks
        self.waits = self._waiting = 0
        self._notes = self.log_type(config, scenario.target.pad_radius_m, Names(self.name, system_id))
        here.answer = self._answer
        self._link.poll(0.0)  # send the first heartbeat before the first tick, as the onboard process does
        # the vehicle and its loop
        self.node = LockstepVehicle(
            system_id, self.name, vehicle, autopilot, here, self._notes, robot=target, grid=grid,
            stop=self._stop, words=self,
        )  # fmt: skip
        self._wires = _Wires(self._link, rate_hz, target)
        self._runner = Runner(self.controller, self._wires, self, self.write)

    def batches(self) -> Batches | None:
        """Return the runner of batches; None: this landing cannot fly in batches, or ``on_step`` is set."""
        if self._on_step is not None or not suited(self.controller, self.node):
            return None
        return Batches(self.controller, self._wires, self.target, self.node, self._notes, self._ends_s)

    @property
    def left(self) -> bool:
        return self._stop.is_set

    def take(self, stop: Stop) -> MemberStatus | None:
        del stop
        return self._message

    def hear(self, words: Sequence[MemberStatus]) -> None:
        arrival_s = self._grid.ns(self.tick + 1) / NS_PER_S
        self._wires.neighbours = tuple(word._replace(arrival_s=arrival_s) for word in words)

    def seen(self) -> Seen:
        """Return the data that a flight log would contain. Raises RuntimeError: the landing did not end."""
        if not self._over:
            raise RuntimeError(f"the landing was not over after {self.ticks_max} ticks")
        return self._notes.seen()

    def _answer(self) -> None:
        if self._over:  # the last step was flown, and the true state after this step is recorded
            self._stop.ask()
            self._message = None
        else:
            self._over = self._runner.tick() is not None

    def write(self, tick: Tick, taken: Taken, out: Outputs, exec_s: float) -> None:
        """Record a tick: step, events and the link's texts; then call ``on_step``."""
        del taken, exec_s
        self._message = out.member_status
        waits = out.phase is Phase.APPROACH and not out.snapshot.permissions.may_land
        self._waiting = self._waiting + 1 if waits else 0
        self.waits = max(self.waits, self._waiting)
        self._notes.step(tick, out)
        for _, text in self._link.take_texts():
            self._notes.note(tick.now_s, 0, "onboard", f"vehicle: {text}")
        if self._on_step is not None:
            self._on_step(tick, out)


@dataclass(frozen=True)
class Landing:
    """Result of a vehicle's flight, and of the ``others`` that flew in the same room."""

    seed: int  # seed of all random draws
    verdict: Verdict  # verdict from true states, with the collisions until the end of the flight
    seen: Seen  # recorded data from which the verdict was computed
    simulated_s: float  # duration of the flight, simulated time
    wall_s: float  # duration of the run, wall time
    retries: int  # number of go-arounds
    wait_s: float  # longest wait for the right of way
    pairs: tuple[FleetPairRow, ...] = ()  # all pairs of vehicles, (1, 2) first
    others: tuple[Landing, ...] = ()  # flights of cf2, cf3 and so on

    @property
    def members(self) -> tuple[Landing, ...]:
        """Flights of all vehicles, cf1 first."""
        return (self, *self.others)


class Flights:
    """All flights of a scenario in this process; arguments as for ``land``.

    ``controller``: controller to fly instead of the scenario's, for a single vehicle.
    """

    def __init__(
        self, scenario: Scenario, seed: int, exchange: Exchange | None = None, on_step: OnStep | None = None,
        controller: Controller | None = None,
    ) -> None:  # fmt: skip
        robot = scenario.target_seed(seed)
        self.members = [
            Companion(each, own, on_step, system_id=n, target_seed=robot, controller=controller)
            for n, (each, own) in enumerate(scenario.singles(seed), 1)
        ]
        self._exchange = exchange or Words(scenario, seed)
        feed = Feed.connect(None, "vehicle", lossless=False)
        self.room = Room([member.node for member in self.members], TickGrid(scenario.rate_hz), feed)
        first, *others = self.members
        self.batches = None if others else first.batches()

    def fly(self) -> None:
        """Fly until all flights are over."""
        loops, batches = [member.node for member in self.members], self.batches
        ticks, batch = max(member.ticks_max for member in self.members), batches.fly if batches else None
        fly_in_lockstep(loops, self.room, self._exchange, Stop(), ticks, batch)


def land(
    scenario: Scenario, seed: int, *, exchange: Exchange | None = None, on_step: OnStep | None = None
) -> Landing:
    """Fly the landings of all vehicles of a scenario and judge each of them.

    A member that no other member approaches flies exactly as in a flight alone, with the member's scenario
    and seed (``Scenario.singles``).

    Args:
        scenario: the whole scenario; its ``onboard`` part configures the flown controller.
        seed: seed of all random draws.
        exchange: transmits the messages of the controllers; None: with the scenario's delay and loss.
        on_step: called after every controller step of each vehicle.

    Raises:
        ValueError: two vehicles overlap at the start.
        RuntimeError: the simulation did not end.
    """
    began_s = time.perf_counter()
    flights = Flights(scenario, seed, exchange, on_step)
    flights.fly()
    seen = [member.seen() for member in flights.members]
    judged = [judge_truth(each, each.truth) for each in seen]
    wall_s = time.perf_counter() - began_s
    first, *others = (
        Landing(
            member.seed, verdict, each, float(each.steps.t_s[-1]), wall_s, member.controller.memory.retries,
            member.waits / scenario.rate_hz,
        )
        for member, each, verdict in zip(flights.members, seen, judged, strict=True)
    )  # fmt: skip
    return replace(first, pairs=flights.room.found(), others=tuple(others))


def warm_up(scenario: Scenario) -> None:
    """Compile all code of a flight, or load it from the cache, before the first flight starts."""
    batches = Flights(scenario, 0).batches
    if batches is None:
        warm_up_room(scenario)
        return
    name, about = scenario.onboard.filter.replace(":", "-"), "the loop of a campaign with this filter"
    with compiling(f"loop-{name}", f"{about}, about 20 s, once for each") as cold:
        if cold:
            at_once(lambda: warm_up_room(scenario), batches.warm_up_controller)
        else:
            warm_up_room(scenario)
        batches.warm_up()


def _warm_up(filters: Sequence[str]) -> None:
    for name in filters:
        warm_up(load("lab").with_filter(name))


if __name__ == "__main__":  # compiles in advance, for these filters, so that no campaign has to wait
    first, *others = sys.argv[1:] or [load("lab").onboard.filter]
    _warm_up([first])
    at_once(lambda: _warm_up(others[::2]), lambda: _warm_up(others[1::2]))
