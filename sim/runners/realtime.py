"""The vehicle process in real time: ticks at absolute deadlines, set-points act when they come.

Between two ticks the loop sleeps on the socket. A frame that arrives wakes it: the physics goes on to that
millisecond, then the frame acts. So a set-point waits for no tick, as on the real vehicle.
"""

from __future__ import annotations

import time

from pymavlink.dialects.v20 import ardupilotmega as dialect

from flightstack.common.pacing import ask_for_priority, give_up_priority
from sim.clock import StopSignal, TickGrid
from sim.runners.deck import RealTimeDeck
from sim.runners.vehicle_runner import VehicleNode

_BEHIND_MAX_S = 0.1  # s; after a longer pause of the machine, simulated time is put back instead of caught up
_MS = 1e-3
_NS_PER_MS = 1_000_000


class RealTimeLoop:
    """Runs ticks until the end."""

    def __init__(
        self, node: VehicleNode, deck: RealTimeDeck | None, grid: TickGrid, stop: StopSignal
    ) -> None:
        self._node, self._deck, self._grid, self._stop = node, deck, grid, stop
        self._deck_stale = False
        self._ms = 0  # simulated so far
        self._start_s = 0.0

    def run(self, ticks: int | None) -> None:
        """Simulate.

        Args:
            ticks: how many; None for no end.
        """
        node, grid = self._node, self._grid
        ask_for_priority()  # a vehicle is nobody's ordinary process: its physics wait for no other program
        self._start_s = time.monotonic()
        node.log.epoch_ns = time.time_ns()  # making the vehicle took a while
        tick = 0
        while not self._stop.is_set and tick != ticks:
            deadline_s = self._start_s + grid.ns(tick) / 1e9
            while (left_s := deadline_s - time.monotonic()) > 0.0 and not self._stop.is_set:
                if node.endpoint.wait(left_s):
                    since_start_ms = int((time.monotonic() - self._start_s) / _MS)
                    self._advance_to(min(since_start_ms, grid.ms(tick)))
                    self._receive()
            self._catch_breath(time.monotonic() - deadline_s)
            self._advance_to(grid.ms(tick))
            self._tick(tick)
            tick += 1

    def _tick(self, tick: int) -> None:
        node, now_ns = self._node, self._grid.ns(tick)
        now_s = now_ns / 1e9
        self._receive()
        node.control(now_s)
        messages = node.autopilot.telemetry(now_s)
        if node.wire.sound:
            node.endpoint.send(messages)
        else:
            node.wire.send(messages, node.endpoint.peers, now_ns)
        truth = node.write_log(tick, now_ns)
        if self._deck is not None:
            for payload in self._deck.poll(now_s):
                node.log.target(now_ns, payload)
            state = self._deck.follow(truth.pad_position_enu_m, truth.pad_yaw_rad, now_s)
            if state is not None:
                node.move_deck(state)
            stale = self._deck.stale(now_s)
            if stale and not self._deck_stale:
                node.autopilot.flight.say(dialect.MAV_SEVERITY_WARNING, "Robot's pose too old: deck stopped")
            self._deck_stale = stale
        node.log.feed.flush()

    def _receive(self) -> None:
        """Act on what has come, now."""
        node, now_s = self._node, self._ms * _MS
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

    def _advance_to(self, ms: int) -> None:
        if ms > self._ms:
            self._node.vehicle.advance(ms - self._ms)
            self._ms = ms

    def _catch_breath(self, late_s: float) -> None:
        """After a long pause go on from here: simulated time stood still, the log's clock moves."""
        if late_s > _BEHIND_MAX_S:
            give_up_priority()
            self._start_s += late_s
            self._node.log.epoch_ns += round(late_s * 1e9)
            self._node.autopilot.flight.say(
                dialect.MAV_SEVERITY_WARNING, f"Machine paused {late_s:.2f} s: simulation too"
            )
