"""The onboard process, vehicle, autopilot, robot and their connections in one process.

Only the connections are replaced: messages are passed directly, with the same rounding. All other code is the
same as in the separate processes.
"""

from __future__ import annotations

from collections.abc import Callable

from bridge.mavlink.client.link import COMPONENT_ID as COMPANION_ID
from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.profiles import OWN_SITL
from bridge.mavlink.server.server import COMPONENT_ID, SYSTEM_ID
from flightstack.common.hangup import Stop
from flightstack.common.pacing import Silence, Tick
from flightstack.compiled.core import with_compiled_program
from flightstack.core.controller import Controller, Outputs
from flightstack.core.types import Neighbour
from flightstack.onboard.leaving import Leaving
from flightstack.onboard.lockstep import VehicleTicks
from flightstack.onboard.runner import LinkedVehicle, Runner, Taken
from logs.schema.names import member_name
from sim.autopilot.autopilot import Autopilot
from sim.clock import TickGrid
from sim.runners.landing_wire import wires
from sim.runners.lockstep import LockstepVehicle
from sim.runners.notes import Notes, Seen, VehicleNotes
from sim.runners.robot import DirectTarget
from sim.runners.stretch.stretch import Stretch, suited
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim

OnStep = Callable[[Tick, Outputs], None]


class Companion:
    """The onboard process, called by the vehicle's loop whenever it waits for an answer.

    ``controller``: flown instead of the scenario's controller; ``on_step``: called after every controller
    step; ``system_id``: MAVLink system id of the vehicle, its number in a team; ``target_seed``: seed of the
    robot, None: ``seed``; ``alone``: no other vehicle is near, so batches of ticks are allowed.
    """

    def __init__(
        self, scenario: Scenario, seed: int, on_step: OnStep | None = None, system_id: int = SYSTEM_ID,
        target_seed: int | None = None, *, alone: bool = True, controller: Controller | None = None,
    ) -> None:  # fmt: skip
        config = scenario.onboard
        rate_hz = config.loop.rate_hz
        self.name = member_name(system_id)  # name and namespace of the vehicle: cf1 for system id 1
        self.controller = with_compiled_program(controller or Controller(config))
        self._on_step = on_step
        self._stop = Stop()
        self._over = False
        self.tick = 0  # current tick of the fleet's vehicles
        grid = TickGrid(rate_hz)
        ticks_max = grid.count(scenario.duration_max_s + config.retreat.abort_time_max_s + 10.0)
        assert ticks_max is not None  # there is a time limit
        self.ticks_max = ticks_max  # maximum number of ticks of a flight
        target = DirectTarget(scenario, seed if target_seed is None else target_seed, grid)
        here, there = wires((system_id, COMPONENT_ID), (system_id, COMPANION_ID))
        self._link = VehicleLink(
            there,
            takeoff_height_m=config.takeoff.height_m,
            profile=OWN_SITL,
            rate_hz=rate_hz,
            system_id=system_id,
            defer_timesync=True,
            power=config.reserve is not None,
        )
        self.vehicle = vehicle = VehicleSim(scenario, seed)  # the simulated vehicle
        trim = vehicle.trim_velocity_enu_m_s
        autopilot = Autopilot(vehicle, rate_hz, system_id=system_id, trim_enu_m_s=trim)
        # outputs of the newest tick; None before the first tick and after the last
        self.outputs: Outputs | None = None
        self._neighbours: tuple[Neighbour, ...] = ()  # messages of other vehicles since the last tick
        self._notes = Notes(config, scenario.target.pad_radius_m)
        self.node = node = VehicleNode(
            system_id, self.name, vehicle, autopilot, here, VehicleNotes(self._notes, self.name)
        )
        here.answer = self._answer
        self._link.poll(0.0)  # sends the first heartbeat, as the process does before the first tick
        radio_s = scenario.vehicle.setpoint_delay_s
        self.loop = LockstepVehicle(node, target, grid, self._stop, radio_s, None if alone else self)
        linked = LinkedVehicle(self._link, lockstep=True)
        leaving = Leaving(scenario.duration_max_s)
        ticks = VehicleTicks(linked, rate_hz)
        # runs batches of ticks; None where this is not possible, or with ``on_step``
        self.stretch = None
        if alone and on_step is None and suited(self.controller, node):
            self.stretch = Stretch(
                self.controller, self._link, ticks, target, node, self.loop, self._notes, grid,
                scenario.duration_max_s, radio_s,
            )  # fmt: skip
        self._runner = Runner(
            self.controller, ticks, linked, target, leaving, self, words=lambda: self._neighbours
        )

    def fly(self) -> None:
        """Fly alone, with batches of ticks where possible."""
        self.loop.begin()
        tick = 0
        while not self._stop.is_set and tick != self.ticks_max:
            flown = self.stretch.fly(tick) if self.stretch is not None else 0
            if not flown:
                self.loop.tick(tick)
            tick += flown or 1

    @property
    def left(self) -> bool:
        """Whether the flight is over."""
        return self._stop.is_set

    def take(self, silence: Silence, stop: Stop) -> Outputs | None:
        """Return the outputs of this tick."""
        del silence, stop
        return self.outputs

    def hear(self, words: tuple[Neighbour, ...]) -> None:
        """Receive the messages of the next tick."""
        self._neighbours = words

    def seen(self) -> Seen:
        """Return the data that a flight log would contain. Raises RuntimeError: the landing did not end."""
        if not self._over:
            raise RuntimeError(f"the landing was not over after {self.ticks_max} ticks")
        return self._notes.seen()

    def _answer(self) -> None:
        if self._over:  # after the last step comes one more true state; then the vehicle's process ends
            self._stop.ask()
            self.outputs = None
        else:
            self._over = self._runner.tick() is not None

    def write(self, tick: Tick, taken: Taken, out: Outputs, exec_s: float) -> None:
        """Record a tick."""
        del taken, exec_s
        self.outputs = out
        self._notes.step(tick, out)
        for _, text in self._link.take_texts():
            self._notes.event(tick.now_s, 0, "onboard", f"vehicle: {text}")
        if self._on_step is not None:
            self._on_step(tick, out)
