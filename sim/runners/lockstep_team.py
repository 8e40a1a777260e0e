"""The vehicles of a fleet in lockstep: a tick ends when all onboard processes have answered and told theirs.

All are asked before any answer is awaited, so that they compute at the same time. What they tell each other
at tick k comes with tick k + 1 at the earliest, late and lossy as the team's exchange has it; wall time has
no part in that. So each member flies as in ``land_team`` with the same seed.
"""

from __future__ import annotations

from collections.abc import Sequence

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import NO_GO, PAIR, Silence
from flightstack.onboard.lockstep import CREDIT_EVERY
from sim.clock import TickGrid
from sim.runners.deck import LockstepDeck
from sim.runners.lockstep import LockstepLoop
from sim.runners.room import Member, Room
from sim.runners.words import MemberWords, Words


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
        """Begin a tick; one whose flight is over flies all of it here."""
        self.words.tick = tick
        if not self.answers and tick - self._credited >= CREDIT_EVERY:
            self._credited = tick
            self._credit.put(PAIR.pack(tick, NO_GO))
        if self.of.over:
            self.loop.coast(tick)
        else:
            self.loop.ask(tick)

    def act(self, tick: int, silence: Silence) -> None:
        """End a tick of one whose flight is not over."""
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
        """Whether nobody flies: one without an onboard process is brought down by its autopilot."""
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
