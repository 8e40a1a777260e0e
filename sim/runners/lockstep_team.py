"""The vehicles of a fleet in lockstep: a tick ends when all onboard processes have sent answer and message.

All are asked before any answer is awaited, so that they compute at the same time. Their messages of tick k
arrive with tick k + 1 at the earliest, with the delay and loss of the team's exchange, independent of wall
time. So each member flies as in ``land_team`` with the same seed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, NO_GO, PAIR, Silence
from flightstack.onboard.lockstep import CREDIT_EVERY, HEARD, OVER, TOLD, joined
from sim.clock import STARTUP_S, NoAnswerError, TickGrid, wait_until
from sim.runners.deck import LockstepDeck
from sim.runners.lockstep import LockstepLoop
from sim.runners.room import Member, Room, Words

_NOTHING = b""
_YIELDS = 20  # looks that only yield the processor: a message is there, or due at once
_PAUSE_S = 50e-6  # s between two looks after that
_MATCH_PAUSE_S = 0.002  # s between two looks for subscribers


class MemberWords:
    """Messages that one member sends and receives, passed on unread.

    ``flightstack.onboard.lockstep.LockstepWords`` is the other end.
    """

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self.namespace, self.tick = namespace, 0  # namespace: of the member; tick: at which the vehicles are
        self._told = zenoh_link.fifo_subscriber(session, f"{namespace}/{TOLD}")
        self._heard = zenoh_link.blocking_publisher(session, f"{namespace}/{HEARD}")
        self._tick, self._payload = -1, _NOTHING
        self._last: int | None = None  # tick after which the process has left
        self._silent = False

    @property
    def is_set(self) -> bool:
        """Whether the onboard process has announced its end before this tick."""
        self._poll()
        return self._last is not None and self._last < self.tick

    def take(self, silence: Silence, stop: Stop) -> bytes | None:
        """Wait for the member's message of this tick, and return it; None: no message.

        A member that answers its vehicle and sends no message is waited for once.

        ``silence``: that of all members in this tick.
        """
        looks = 0
        while not self._told_now() and not self._silent and not stop.is_set:
            if silence.look() > COMPANION_SILENT_S:
                self._silent = True
            looks += 1
            time.sleep(0.0 if looks <= _YIELDS else _PAUSE_S)
        return self._payload if self._tick == self.tick and self._payload else None

    def hear(self, words: list[bytes]) -> None:
        """Send the messages that the member receives with the next tick."""
        self._heard.put(joined(words), attachment=PAIR.pack(self.tick + 1, len(words)))

    def await_listener(self, stop: Stop) -> None:
        """Wait until the member has subscribed: earlier messages are lost and are not repeated.

        Raises NoAnswerError: it does not.
        """

        def matched() -> bool:
            return zenoh_link.is_matched(self._heard)

        if not wait_until(matched, stop, STARTUP_S, pause_s=_MATCH_PAUSE_S):
            raise NoAnswerError(
                f"nobody subscribed to {self.namespace}/{HEARD} within {STARTUP_S:g} s; is its onboard "
                "process running in lockstep, with a table [fleet], and connected to this process's endpoint?"
            )

    def _told_now(self) -> bool:
        self._poll()
        return self._tick >= self.tick or self._last is not None

    def _poll(self) -> None:
        for sample in zenoh_link.drain(self._told):
            tick, over = PAIR.unpack(sample.attachment.to_bytes())
            if over == OVER:
                self._last = tick
            else:
                self._tick, self._payload = tick, sample.payload.to_bytes()
                self._silent = False


class LockstepMember:
    """A member with its loop, its words, and credit for its robot when no onboard process gives any.

    ``session``: connects robots and onboard processes; ``radio_s``: delay of set-points to the vehicle.
    """

    def __init__(
        self, member: Member, session: zenoh_link.Session, grid: TickGrid, stop: Stop, radio_s: float
    ) -> None:
        self.of, self.words = member, MemberWords(session, member.name)
        deck = LockstepDeck(session, member.name)
        self.loop = LockstepLoop(member.node, deck, grid, stop, radio_s, self.words)
        self._credit = zenoh_link.blocking_publisher(session, f"{member.name}/sim/credit")
        self._credited = -CREDIT_EVERY

    @property
    def answers(self) -> bool:
        """Whether its onboard process is there."""
        return self.loop.answers and not self.of.over

    def ask(self, tick: int) -> None:
        """Start a tick; a member whose flight is over flies all of it here."""
        self.words.tick = tick
        if not self.answers and tick - self._credited >= CREDIT_EVERY:
            self._credited = tick
            self._credit.put(PAIR.pack(tick, NO_GO))
        if self.of.over:
            self.loop.coast(tick)
        else:
            self.loop.ask(tick)

    def act(self, tick: int, silence: Silence) -> None:
        """End a tick of a member whose flight is not over."""
        if not self.of.over:
            self.loop.act(tick, silence)
            self.of.over = self.words.is_set


class TeamLockstep:
    """Runs ticks until the flights of all are over.

    ``words``: passes their messages on; ``epoch_ns``: Unix time of tick 0.
    """

    def __init__(
        self, members: Sequence[LockstepMember], room: Room, words: Words, stop: Stop, epoch_ns: int
    ) -> None:
        self._members, self._room, self._words = members, room, words
        self._stop, self._epoch_ns = stop, epoch_ns

    def run(self, ticks: int | None) -> None:
        """Simulate.

        ``ticks``: number of ticks; None: no end.
        Raises NoAnswerError: a companion or a target never came.
        """
        for member in self._members:
            member.words.await_listener(self._stop)
            member.loop.begin()
        tick = 0
        while not self._stop.is_set and tick != ticks and not self._over():
            self._tick(tick)
            tick += 1
        if tick:
            self._room.write(tick - 1, self._epoch_ns)

    def _over(self) -> bool:
        """Whether no vehicle flies: without an onboard process the autopilot lands it."""
        return all(each.of.over or not (each.answers or each.of.vehicle.armed) for each in self._members)

    def _tick(self, tick: int) -> None:
        members, silence = self._members, Silence()
        self._room.begin()
        for member in members:
            member.ask(tick)
        for member in members:
            member.act(tick, silence)
        self._room.end(tick, self._epoch_ns)
        told = [each.words.take(silence, self._stop) if each.answers else None for each in members]
        for member, heard in zip(members, self._words.pass_on(tick, told), strict=True):
            if member.answers:
                member.words.hear(heard)
