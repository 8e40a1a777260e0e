"""Vehicles and robots in real time handle messages on arrival and send at each tick."""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.common.hangup import Stop
from flightstack.common.pacing import give_up_priority, run_promptly
from sim.clock import TickGrid
from sim.runners.published_robot import RealTimeRobot
from sim.runners.robot import RealTimeDeck
from sim.runners.room import Room
from sim.runners.vehicle_node import VehicleNode

_BEHIND_MAX_S = 0.1  # largest delay that simulated time catches up, s; a longer one shifts the clock
_MS = 1e-3
_NS_PER_MS = 1_000_000


class RealTimeVehicle:
    """One vehicle in real time.

    ``robot``: a robot of this process, or true poses from another process; None: the deck does not move.
    """

    def __init__(self, node: VehicleNode, robot: RealTimeRobot | RealTimeDeck | None, grid: TickGrid) -> None:
        self.node, self._robot, self._grid = node, robot, grid
        self._ms = 0  # simulated time, ms

    def tick(self, tick: int) -> None:
        """Send messages and write the log for a tick; the vehicle has been simulated up to it."""
        node, now_ns = self.node, self._grid.ns(tick)
        now_s = now_ns / 1e9
        self.receive()
        node.control(now_s)
        messages = node.autopilot.telemetry(now_s)
        if node.wire.sound:
            node.endpoint.send(messages)
        else:
            node.wire.send(messages, node.endpoint.peers, now_ns)
        if isinstance(self._robot, RealTimeRobot):
            deck = self._robot.take(tick)
            node.move_deck(deck)
            node.log.target(now_ns, deck.payload)
        truth = node.write_log(tick, now_ns)
        if isinstance(self._robot, RealTimeDeck):
            state = self._robot.move(now_s, truth, partial(node.log.target, now_ns), self.warn)
            if state is not None:
                node.move_deck(state)
        node.log.feed.flush()

    def receive(self) -> None:
        """Handle the messages that have arrived."""
        node, now_s = self.node, self._ms * _MS
        now_ns = self._ms * _NS_PER_MS
        frames = node.wire.late(now_ns)
        for received in node.endpoint.receive():
            frames += node.wire.receive(received, now_ns)
        for received in frames:
            replies = node.answer(received, now_s)
            if replies and node.wire.sound:
                node.endpoint.send(replies, received.peer)
            elif replies:
                node.wire.send(replies, (received.peer,), now_ns)
        if frames:
            node.control(now_s)

    def advance_to(self, ms: int) -> None:
        """Simulate up to this time."""
        if ms > self._ms:
            self.node.vehicle.advance(ms - self._ms)
            self._ms = ms

    def warn(self, text: str) -> None:
        """Send a warning to the clients as a status text of the autopilot."""
        self.node.autopilot.flight.texts.say(dialect.MAV_SEVERITY_WARNING, text)


class RealTimeWorld:
    """Runs ticks until the end.

    ``vehicles``: at least one; ``robots``: all robots of this process, also those without a vehicle here;
    ``stop``: ends the process.
    """

    def __init__(
        self,
        vehicles: Sequence[RealTimeVehicle],
        robots: Sequence[RealTimeRobot],
        room: Room,
        grid: TickGrid,
        stop: Stop,
    ) -> None:
        self._vehicles, self._grid, self._stop, self._room = vehicles, grid, stop, room
        self._robots = robots
        self._start_s, self._epoch_ns = 0.0, 0

    def run(self, ticks: int | None) -> None:
        """Run the simulation. ``ticks``: number of ticks; None: no end."""
        vehicles, grid, room = self._vehicles, self._grid, self._room
        followed = [robot for robot in self._robots if robot.followed]
        run_promptly()  # the physics must not wait for other programs, as in a real vehicle
        self._start_s = time.monotonic()
        self._set_epoch(time.time_ns())  # set here, because the creation of the vehicles took time
        for robot in self._robots:
            robot.begin()
        tick = 0
        while not self._stop.is_set and tick != ticks:
            deadline_s = self._start_s + grid.ns(tick) / 1e9
            while (left_s := deadline_s - time.monotonic()) > 0.0 and not self._stop.is_set:
                for vehicle in self._heard(left_s):
                    since_start_ms = int((time.monotonic() - self._start_s) / _MS)
                    vehicle.advance_to(min(since_start_ms, grid.ms(tick)))
                    vehicle.receive()
            self._resync_clock(time.monotonic() - deadline_s)
            for vehicle in vehicles:
                vehicle.advance_to(grid.ms(tick))
            if tick > 0:
                room.end(tick - 1, self._epoch_ns)
            room.begin()
            for vehicle in vehicles:
                vehicle.tick(tick)
            for robot in followed:
                robot.take(tick)
            tick += 1
        if tick > 1:
            room.write(tick - 2, self._epoch_ns)

    def _heard(self, within_s: float) -> Sequence[RealTimeVehicle]:
        """Wait at most ``within_s`` for frames; return the vehicles that received some."""
        by_number = {vehicle.node.endpoint.fileno(): vehicle for vehicle in self._vehicles}
        ready, _, _ = select.select(list(by_number), (), (), within_s)
        return [by_number[number] for number in ready]

    def _set_epoch(self, epoch_ns: int) -> None:
        self._epoch_ns = epoch_ns
        for log in (*(each.node.log for each in self._vehicles), *(each.log for each in self._robots)):
            log.epoch_ns = epoch_ns

    def _resync_clock(self, late_s: float) -> None:
        """After a long pause of simulated time, shift the log's clock instead of catching up."""
        if late_s > _BEHIND_MAX_S:
            give_up_priority()
            self._start_s += late_s
            self._set_epoch(self._epoch_ns + round(late_s * 1e9))
            for vehicle in self._vehicles:
                vehicle.warn(f"Machine paused {late_s:.2f} s: simulation too")
