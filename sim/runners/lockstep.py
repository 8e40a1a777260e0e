"""Vehicles in lockstep: simulated time advances when all companions have answered for a tick.

The messages are those of docs/how_it_works/lockstep.md. All requests are sent before the first answer is
awaited, so the companions compute in parallel. Link faults affect all messages except TIMESYNC. Each member
flies exactly as in ``land`` with the same seed.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Received
from bridge.mavlink.transport.address import Peer
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, EPOCH_NS, wait_until
from sim.clock import STARTUP_S, NoAnswerError, TickGrid
from sim.runners.robot import Robot
from sim.runners.room import FleetEnd, Room
from sim.runners.vehicle_node import VehicleNode

_WAIT_S = 0.05  # wall time between two checks for signals, s
_REPEAT_EVERY = 10  # number of checks after which an unanswered request is repeated
_FLUSH_EVERY = 10  # period of the log flush, ticks; a shorter period would wake the recorder more often
_TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
_HEARTBEAT: int = dialect.MAVLINK_MSG_ID_HEARTBEAT


# function that receives the number of a tick that all vehicles have flown, and the companions' messages; it
# returns the messages that each companion receives with the next tick
Exchange = Callable[[int, Sequence[Any]], Sequence[Any]]


@dataclass(slots=True, kw_only=True)
class LockstepVehicle(VehicleNode):
    """One vehicle, with its companion and its robot."""

    robot: Robot | None  # robot that carries the deck; None: the deck does not move
    grid: TickGrid
    stop: Stop  # ends every wait
    words: FleetEnd  # link between the companion and the other members
    answered: bool = field(default=False, init=False)  # whether the companion answered the previous tick
    _companion: Peer | None = field(default=None, init=False)  # the peer that answered first
    _alive: bool = field(default=True, init=False)  # False after a time-out until the companion answers
    _replies: list[Message] = field(default_factory=list, init=False)  # replies for the next tick
    _late: list[Received] = field(default_factory=list, init=False)  # frames that belong to the next tick
    _request: Message = field(default=None, init=False)  # request of this tick

    @property
    def radio_ms(self) -> int:
        """Delay of set-points by the radio, ms."""
        return self.vehicle.firmware.delay_ms

    @property
    def answers(self) -> bool:
        """Whether the vehicle waits for its companion, which has neither left nor timed out."""
        return self._alive and not self.over

    @property
    def rests(self) -> bool:
        """Whether the vehicle needs no more ticks; without a companion the autopilot first lands."""
        return self.over or not (self._alive or self.vehicle.armed)

    @property
    def undisturbed(self) -> bool:
        """Whether the companion answers at each tick, and no message waits for the next tick."""
        waits = self._replies or self._late or not self.wire.sound
        return self._companion is not None and self._alive and not waits

    def begin(self) -> None:
        """Wait for a companion and for the subscribers of its robot, so that tick 0 is complete.

        Raises NoAnswerError: time-out.
        """
        endpoint = self.endpoint

        def heard() -> bool:
            if not endpoint.peers:
                endpoint.wait(_WAIT_S)
                self._late += endpoint.receive()
            return bool(endpoint.peers)

        what = "a companion to speak first"
        if not wait_until(heard, lambda: self.stop.is_set, STARTUP_S, pause_s=0.0, what=what):
            raise NoAnswerError(f"no companion was heard on the MAVLink endpoint within {STARTUP_S:g} s")
        if self.robot is not None:
            self.robot.begin()

    def ask(self, tick: int) -> None:
        """Begin a tick: send due messages, request the answer, and simulate until the answer can take effect.

        After the end of its flight, a vehicle simulates the whole tick in this call: the autopilot still
        controls the vehicle, but nothing is sent or logged.
        """
        robot, vehicle, now_ns = self.robot, self.vehicle, self.grid.ns(tick)
        now_s, steps = now_ns / 1e9, self.grid.ms(tick + 1) - self.grid.ms(tick)
        self.words.tick = tick
        if robot is not None:
            if self.answers:
                robot.await_credit(tick)
            self.carry(robot, tick, now_ns)
        if self.over:
            vehicle.sent_before_ms = 0
            self.control(now_s)
            vehicle.advance(steps)
            return
        messages, self._replies = [*self.autopilot.telemetry(now_s), *self._replies], []
        self._request = dialect.MAVLink_timesync_message(0, now_ns)
        self.wire.send(messages, now_ns, self._companion, last=[self._request])
        # write the state of this tick while the companion computes
        self.write_log(tick, now_ns)
        if tick % _FLUSH_EVERY == 0:
            self.log.feed.flush()
        if robot is not None:
            robot.run_ahead(tick)
        # The radio delays every answer by this time, so these steps need no answer.
        ahead = min(steps, self.radio_ms)
        vehicle.advance(ahead)
        vehicle.sent_before_ms = ahead

    def act(self, tick: int) -> None:
        """End a tick: wait for the companion's answer, handle it, and simulate the remaining steps.

        Raises NoAnswerError: time-out.
        """
        if self.over:
            return
        grid, vehicle, now_ns = self.grid, self.vehicle, self.grid.ns(tick)
        self._await_answer(now_ns)
        self.control(now_ns / 1e9)
        vehicle.advance(grid.ms(tick + 1) - grid.ms(tick) - vehicle.sent_before_ms)
        self.over = self.words.left

    def _await_answer(self, now_ns: int) -> None:
        """Handle all messages up to the companion's answer for this tick."""
        for received in self.wire.late(now_ns):
            self._replies += self.answer(received, now_ns / 1e9)
        late, self._late = self._late, []
        self.answered = self._take(late, now_ns)
        if not self._alive:
            self._take(self.endpoint.receive(), now_ns)
            self.answered = False
        elif not self.answered:
            looks = itertools.count(1)

            def answered() -> bool:
                self.endpoint.wait(_WAIT_S)
                self.answered = self._take(self.endpoint.receive(), now_ns)
                if not self.answered and next(looks) % _REPEAT_EVERY == 0:
                    # repeat the same bytes: new sequence numbers would make the log depend on wall time
                    self.endpoint.repeat(bytes(self._request.get_msgbuf()), self._companion)
                return self.answered

            def ended() -> bool:
                return self.stop.is_set or self.words.left

            most_s = COMPANION_SILENT_S if self._companion else STARTUP_S
            if not (ended() or wait_until(answered, ended, most_s, pause_s=0.0)):
                self._give_up()
            # handle frames that the companion sent before its end
            self.answered = self.answered or self._take(self.endpoint.receive(), now_ns)

    def _take(self, frames: list[Received], now_ns: int) -> bool:
        """Handle frames up to the companion's answer for this tick; return whether the answer has arrived."""
        for i, received in enumerate(frames):
            message, companion = received.message, self._companion
            id_ = message.get_msgId()
            if companion not in (None, received.peer):
                continue  # only the companion is served, since other clients depend on wall time
            if id_ == _TIMESYNC and message.tc1 != 0:
                this_tick = message.ts1 == now_ns
                if this_tick:
                    self._companion = received.peer
                if self._companion and not self._alive:  # even an old answer proves that the companion runs
                    self._alive = True
                    self.report(dialect.MAV_SEVERITY_NOTICE, "Companion answers again")
                if this_tick:
                    self._late += frames[i + 1 :]
                    return True
            elif companion is None and id_ == _HEARTBEAT:
                # No link fault acts here: the number of heartbeats before the answer depends on wall time.
                self._replies += self.answer(received, now_ns / 1e9)
            else:
                for arrived in self.wire.receive(received, now_ns):
                    self._replies += self.answer(arrived, now_ns / 1e9)
        return False

    def _give_up(self) -> None:
        if self._companion is None:
            raise NoAnswerError(
                f"no companion answered the TIMESYNC of tick 0 within {STARTUP_S:g} s; "
                "does it run in lockstep?"
            )
        self._alive = False
        text = f"Companion silent for {COMPANION_SILENT_S:g} s: going on without"
        self.report(dialect.MAV_SEVERITY_CRITICAL, text)


def fly_in_lockstep(
    vehicles: Sequence[LockstepVehicle],
    room: Room,
    exchange: Exchange,
    stop: Stop,
    ticks: int | None,
    batch: Callable[[int], int] | None = None,
) -> int:
    """Run the ticks of all vehicles until a stop request or the end of all flights; return their number.

    ``exchange``: transmits the messages of a fleet; ``ticks``: largest number of ticks; None: no limit;
    ``batch``: flies a batch of ticks from the given tick on, and returns the number of ticks (0: none).
    Raises NoAnswerError: time-out of a companion.
    """

    def ended() -> bool:
        if stop.is_set:  # the true state of the answered tick is still logged
            return all(each.over or not each.answered for each in vehicles)
        return all(each.over for each in vehicles)

    for vehicle in vehicles:
        vehicle.begin()
    tick = 0
    while tick != ticks and not ended():
        if all(each.rests for each in vehicles):  # wait in real time: a silent companion may return
            time.sleep(vehicles[0].grid.period_s)
        flown = batch(tick) if batch is not None else 0
        if not flown:
            _tick(vehicles, room, exchange, stop, tick)
        tick += flown or 1
    if tick:
        room.write(tick - 1, EPOCH_NS)
    return tick


def _tick(vehicles: Sequence[LockstepVehicle], room: Room, exchange: Exchange, stop: Stop, tick: int) -> None:
    room.begin()
    for vehicle in vehicles:
        vehicle.ask(tick)
    for vehicle in vehicles:
        vehicle.act(tick)
    room.end(tick, EPOCH_NS)
    sent = [each.words.take(stop) if each.answers else None for each in vehicles]
    for vehicle, received in zip(vehicles, exchange(tick, sent), strict=True):
        if vehicle.answers:
            vehicle.words.hear(received)
