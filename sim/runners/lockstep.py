"""The vehicle process in lockstep: simulated time continues when the companion has answered for a tick.

Tick k is at t = k / rate. The vehicle sends what is due and TIMESYNC(tc1=0, ts1=t in ns) in one datagram; the
companion acts on it and answers with TIMESYNC(tc1 != 0, ts1=t). Everything that came before that answer is
handled at t, then the physics continues to the next tick. A companion that stops answering does not stop the
world: after 20 s of wall time the simulation runs on, so that fail-safes act, until it answers again.
Faults of the wire concern everything but this handshake.
"""

from __future__ import annotations

import time
from typing import Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Received
from bridge.mavlink.transport.address import Peer
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, TARGET_LOOK_S, TARGET_SILENT_S, Silence
from flightstack.core.types import ZERO
from sim.clock import STARTUP_S, NoAnswerError, TickGrid, wait_until
from sim.runners.deck import STALE_S, DeckState, LockstepDeck, reckon
from sim.runners.vehicle_node import VehicleNode

_WAIT_S = 0.05  # s of wall time between two looks at the signals
_REPEAT_S = 0.5  # s of wall time until a request is repeated
_REPEAT_UNHEARD_S = 0.05  # s, the same before the first message of a companion
_DECK_LOOK_S = 0.02  # s between two looks for a robot that is slow
_DECK_YIELDS = 20  # looks for the deck's pose before sleeping: it is there, or due any moment
_FLUSH_EVERY = 10  # ticks; the recorder is not woken for every single one
_TIMESYNC: int = dialect.MAVLINK_MSG_ID_TIMESYNC
_HEARTBEAT: int = dialect.MAVLINK_MSG_ID_HEARTBEAT


class Left(Protocol):
    """Whether the companion has left for good."""

    @property
    def is_set(self) -> bool:
        """Whether it has: it is waited for no longer."""


class LockstepLoop:
    """Runs ticks until the end.

    ``deck``: true poses of the robot; None: it stands; ``radio_s``: delay of set-points to the vehicle;
    ``left``: whether the companion of one of several vehicles has left; None: it stays until ``stop``.
    """

    def __init__(
        self,
        node: VehicleNode,
        deck: LockstepDeck | None,
        grid: TickGrid,
        stop: Stop,
        radio_s: float,
        left: Left | None = None,
    ) -> None:
        self._radio_ms = round(radio_s * 1000.0)
        self._node, self._deck, self._grid, self._stop = node, deck, grid, stop
        self._alone = left is None
        self._left = stop if left is None else left
        self._companion: Peer | None = None  # the peer that answered first
        self._answers = True  # the companion is waited for
        self._answered = False  # it has answered for the tick before
        self._replies: list[Message] = []  # replies to the companion, sent with the next tick
        self._late: list[Received] = []  # came after the answer: belongs to the next tick
        self._deck_comes = deck is not None
        self._deck_last: DeckState | None = None
        self._deck_s = 0.0  # time of the last true pose
        self._request: Message = None  # request of this tick

    @property
    def answers(self) -> bool:
        """Whether the companion is waited for: it has answered so far."""
        return self._answers

    @property
    def undisturbed(self) -> bool:
        """Whether companion and deck come at each tick, and nothing waits for the next one."""
        waits = self._replies or self._late or not self._node.wire.sound
        return self._companion is not None and self._answers and self._deck_comes and not waits

    def passed(self, now_ns: int, deck: DeckState) -> None:
        """Account for ticks until now that were flown as a batch; ``deck``: pose of the robot at the last."""
        self._deck_last, self._deck_s = deck, now_ns * 1e-9

    def run(self, ticks: int | None) -> None:
        """Simulate.

        ``ticks``: number of ticks; None: no end.
        Raises NoAnswerError: companion or target never came.
        """
        self.begin()
        tick = 0
        # an answer that was there in time has a true state after it, however late this process gets to run
        while tick != ticks and (self._answered or not self._stop.is_set):
            self.tick(tick)
            tick += 1

    def begin(self) -> None:
        """Wait for a companion and for the first pose of the deck: tick 0 must be complete.

        Raises NoAnswerError: companion or target never came.
        """
        endpoint, deck = self._node.endpoint, self._deck

        def heard() -> bool:
            if not endpoint.peers:
                endpoint.wait(_WAIT_S)
                self._late += endpoint.receive()
            return bool(endpoint.peers)

        if not wait_until(heard, self._stop, STARTUP_S, pause_s=0.0, what="a companion to speak first"):
            raise NoAnswerError(f"no companion was heard on the MAVLink endpoint within {STARTUP_S:g} s")
        if deck is not None and not wait_until(
            lambda: deck.has(0), self._stop, STARTUP_S, pause_s=0.002, what="the robot's pose over Zenoh"
        ):
            raise NoAnswerError(
                f"no true pose of the robot came over Zenoh within {STARTUP_S:g} s; is the target running, "
                "and connected to this process's endpoint?"
            )

    def tick(self, tick: int) -> None:
        """Simulate one tick, which must be the next one.

        ``tick``: its number.
        Raises NoAnswerError: the companion never came.
        """
        self.ask(tick)
        self.act(tick)

    def ask(self, tick: int) -> None:
        """Begin a tick: send what is due, ask the companion, and simulate what does not wait for its answer.

        ``tick``: number of the next tick.
        """
        node, grid = self._node, self._grid
        now_ns = grid.ns(tick)
        now_s = now_ns / 1e9
        if self._deck is not None:
            self._move_deck(self._deck, tick, now_ns)
        self._send(now_ns, now_s)
        # The state of this tick is written while the companion works on it.
        node.write_log(tick, now_ns)
        if tick % _FLUSH_EVERY == 0:
            node.log.feed.flush()
        # Whatever the answer is, the radio delays it: so much can be simulated before it is known.
        steps = grid.ms(tick + 1) - grid.ms(tick)
        ahead = min(steps, self._radio_ms)
        node.vehicle.advance(ahead)
        node.vehicle.sent_before_ms = ahead

    def act(self, tick: int, silence: Silence | None = None) -> None:
        """End a tick: await the companion's answer, act on it, and simulate the rest.

        ``tick``: its number, that of ``ask``; ``silence``: that of the companions of all vehicles in
        this tick; None: of this one.
        Raises NoAnswerError: the companion never came.
        """
        node, grid = self._node, self._grid
        now_ns = grid.ns(tick)
        now_s = now_ns / 1e9
        self._await_answer(now_ns, now_s, silence)
        node.control(now_s)
        node.vehicle.advance(grid.ms(tick + 1) - grid.ms(tick) - node.vehicle.sent_before_ms)

    def coast(self, tick: int) -> None:
        """Simulate one tick without the companion, which has left: the vehicle stays where its robot is.

        Nothing is sent or written, for the flight is over; its autopilot still sees to the vehicle.

        ``tick``: number of the next tick.
        """
        node, grid = self._node, self._grid
        now_ns = grid.ns(tick)
        if self._deck is not None:
            self._move_deck(self._deck, tick, now_ns)
        node.vehicle.sent_before_ms = 0
        node.control(now_ns / 1e9)
        node.vehicle.advance(grid.ms(tick + 1) - grid.ms(tick))

    def _move_deck(self, deck: LockstepDeck, tick: int, now_ns: int) -> None:
        node = self._node
        if self._deck_comes and self._answers:
            self._deck_comes = deck.has(tick) or self._await_deck(deck, tick)
            if not self._deck_comes:
                text = "Robot silent: going on without"
                node.autopilot.flight.say(dialect.MAV_SEVERITY_WARNING, text)
        state = deck.take(tick)
        if state is not None:
            self._deck_comes, self._deck_last, self._deck_s = True, state, now_ns * 1e-9
            node.move_deck(state)
            node.log.target(now_ns, state.payload)
            return
        age_s = now_ns * 1e-9 - self._deck_s
        if self._deck_last is not None and age_s > STALE_S:  # until then it continues along its arc
            stopped = reckon(self._deck_last, age_s)._replace(velocity_enu_m_s=ZERO, yaw_rate_rad_s=0.0)
            self._deck_last = None
            node.move_deck(stopped)
            node.autopilot.flight.say(dialect.MAV_SEVERITY_WARNING, "Robot's pose too old: deck stopped")

    def _await_deck(self, deck: LockstepDeck, tick: int) -> bool:
        """Return whether the pose comes: the robot is slow, and neither gone nor stopped for a minute."""
        if not wait_until(lambda: deck.has(tick), self._stop, TARGET_LOOK_S, yields=_DECK_YIELDS):
            wait_until(
                lambda: deck.has(tick) or not deck.is_alive, self._stop, TARGET_SILENT_S, pause_s=_DECK_LOOK_S
            )
        return deck.has(tick)

    def _await_answer(self, now_ns: int, now_s: float, silence: Silence | None) -> None:
        """Handle everything up to the companion's answer for this tick."""
        for received in self._node.wire.late(now_ns):
            self._answer(received, now_ns, now_s)
        late, self._late = self._late, []
        answered = self._take(late, now_ns, now_s)
        if not self._answers:
            self._answered = False
            self._run_free(now_ns, now_s)
            return
        endpoint, repeat_s = self._node.endpoint, None
        while not answered and not self._left.is_set:
            endpoint.wait(_WAIT_S if self._companion else _REPEAT_UNHEARD_S)
            answered = self._take(endpoint.receive(), now_ns, now_s)
            if answered:  # mostly at the first look, which needs no clock
                break
            silence = silence or Silence()
            repeat_s = repeat_s or time.monotonic()
            if silence.look() > (COMPANION_SILENT_S if self._companion else STARTUP_S):
                self._give_up()
                break
            wall_s = time.monotonic()
            if wall_s - repeat_s > (_REPEAT_S if endpoint.counters.received else _REPEAT_UNHEARD_S):
                repeat_s = wall_s
                self._repeat()
        # frames received before the companion left
        self._answered = answered or self._take(endpoint.receive(), now_ns, now_s)

    def _send(self, now_ns: int, now_s: float) -> None:
        endpoint, companion = self._node.endpoint, self._companion
        messages = self._node.autopilot.telemetry(now_s)
        replies, self._replies = self._replies, []
        request = dialect.MAVLink_timesync_message(0, now_ns)
        if not self._node.wire.sound:
            companions = endpoint.peers if companion is None else (companion,)
            others = [peer for peer in endpoint.peers if peer not in companions]
            self._node.wire.send(messages, (*companions, *others), now_ns)
            self._node.wire.send(replies, companions, now_ns)
            messages = replies = []
        elif companion is not None:
            for peer in endpoint.peers:
                if peer != companion:
                    endpoint.send(messages, peer)
        endpoint.send([*messages, *replies, request], companion)
        self._request = request

    def _repeat(self) -> None:
        peers = self._node.endpoint.peers if self._companion is None else (self._companion,)
        for peer in peers:
            # The same bytes, or the number of repeats, a matter of wall time, would show in the log.
            self._node.endpoint.repeat(bytes(self._request.get_msgbuf()), peer)

    def _take(self, frames: list[Received], now_ns: int, now_s: float) -> bool:
        """Handle frames up to the answer for this tick; True when it was there."""
        for i, received in enumerate(frames):
            message = received.message
            id_ = message.get_msgId()
            if id_ == _TIMESYNC and message.tc1 != 0:
                if self._is_answer(received, now_ns):
                    self._late += frames[i + 1 :]
                    return True
                continue
            if self._companion is None and id_ == _HEARTBEAT:
                # Not through the simulated loss: how many heartbeats come first depends on wall time.
                self._answer(received, now_ns, now_s)
                continue
            for arrived in self._node.wire.receive(received, now_ns):
                self._answer(arrived, now_ns, now_s)
        return False

    def _answer(self, received: Received, now_ns: int, now_s: float) -> None:
        """Let the autopilot act; what it answers the companion goes with the next tick."""
        replies = self._node.answer(received, now_s)
        if not replies:
            return
        if received.peer == self._companion or self._companion is None:
            self._replies += replies
        elif self._node.wire.sound:
            self._node.endpoint.send(replies, received.peer)
        else:
            self._node.wire.send(replies, (received.peer,), now_ns)

    def _is_answer(self, received: Received, now_ns: int) -> bool:
        """Whether the companion has answered for this tick; an older answer shows that it is alive."""
        this_tick: bool = received.message.ts1 == now_ns
        if self._companion is None and this_tick:
            self._companion = received.peer
        if received.peer != self._companion:
            return False
        if not self._answers:
            self._answers = True
            self._node.autopilot.flight.say(dialect.MAV_SEVERITY_NOTICE, "Companion answers again")
        return this_tick

    def _give_up(self) -> None:
        if self._companion is None:
            raise NoAnswerError(
                f"no companion answered the TIMESYNC of tick 0 within {STARTUP_S:g} s; "
                "does it run in lockstep?"
            )
        self._answers = False
        text = f"Companion silent for {COMPANION_SILENT_S:g} s: going on without"
        self._node.autopilot.flight.say(dialect.MAV_SEVERITY_CRITICAL, text)

    def _run_free(self, now_ns: int, now_s: float) -> None:
        """Without the companion: as fast as it goes while flying, in real time once it has landed."""
        endpoint = self._node.endpoint
        if self._alone and not self._node.vehicle.armed:
            endpoint.wait(self._grid.period_s)
        self._take(endpoint.receive(), now_ns, now_s)
