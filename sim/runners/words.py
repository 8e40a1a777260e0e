"""Messages between the members of a team: which are late, which get lost, and how they pass in lockstep.

A message sent at tick k arrives at tick k + 1 at the earliest. Whether one is lost depends on the seed,
the sender and the receiver, so that it does not change when members are added. Over the wires the messages
are passed on unread (``flightstack.onboard.lockstep.LockstepWords`` has the other end).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, TypeVar

from bridge.zenoh import zenoh_link
from flightstack.common.hangup import Stop
from flightstack.common.pacing import COMPANION_SILENT_S, PAIR, Silence
from flightstack.core.controller import Outputs
from flightstack.core.types import Neighbour
from flightstack.onboard.lockstep import HEARD, OVER, TOLD, joined
from sim.chance import member as seed_of
from sim.chance import stream
from sim.clock import NS_PER_S, STARTUP_S, NoAnswerError, TickGrid, wait_until
from sim.scenarios.team import TeamScenario

T = TypeVar("T")

_BLOCK = 256  # random numbers drawn at once
_NOTHING = b""
_YIELDS = 20  # looks that only give up the processor: a word is there, or due any moment
_PAUSE_S = 50e-6  # s between two looks after that
_MATCH_PAUSE_S = 0.002  # s between two looks for subscribers


class Words:
    """Passes words on, as ``TeamScenario.exchange`` has it."""

    def __init__(self, team: TeamScenario, seed: int) -> None:
        link, rate_hz = team.exchange, team.rate_hz
        silent, apart = frozenset(link.silent), frozenset(link.apart)
        broken_tick = math.ceil(link.broken_from_s * rate_hz - 1e-9)
        self._grid = TickGrid(rate_hz)
        self._ticks = max(1, math.ceil(link.delay_s * rate_hz - 1e-9))
        numbers = range(1, len(team.member) + 1)
        self._ways: list[list[_Way]] = []
        for hearer in numbers:
            broken = {n for n in numbers if n in silent or (n in apart) != (hearer in apart)}
            since = {n: broken_tick if n in broken else math.inf for n in numbers}
            since[hearer] = 0  # nobody hears itself
            self._ways.append([_Way(seed, n, hearer, link.loss, since[n]) for n in numbers])
        self._under_way: deque[list[list[Any]]] = deque([[] for _ in numbers] for _ in range(self._ticks - 1))

    def __call__(self, tick: int, outputs: Sequence[Outputs | None]) -> list[tuple[Neighbour, ...]]:
        """Take the outputs of a tick; return the words that each member hears with the next one.

        ``outputs``: those of all controllers at this tick; None where the flight is over.
        """
        arrive_s = self._grid.ns(tick + self._ticks) / NS_PER_S
        told = [None if each is None else each.own_word for each in outputs]
        on_time = [word and word._replace(arrival_s=arrive_s) for word in told]
        return [tuple(words) for words in self.pass_on(tick, on_time)]

    def pass_on(self, tick: int, told: Sequence[T | None]) -> list[list[T]]:
        """Take what is told at a tick, in any form; return what each member hears with the next one.

        ``told``: message of each member; None: none.
        """
        self._under_way.append(
            [
                [
                    word
                    for word, way in zip(told, ways, strict=True)
                    if not way.loses(tick) and word is not None
                ]
                for ways in self._ways
            ]
        )
        return self._under_way.popleft()


class _Way:
    """The way of one teller's words to one hearer; it loses them by chance, and all from a tick on."""

    def __init__(self, seed: int, teller: int, hearer: int, loss: float, broken_tick: float) -> None:
        self._loss, self._broken_tick = loss, broken_tick
        self._chance = stream(seed_of(seed, hearer), f"words.{teller}")
        self._drawn: list[float] = []

    def loses(self, tick: int) -> bool:
        """Whether what is told at a tick is lost; asked in each tick, so that what is told shifts nothing."""
        if self._loss > 0.0 and self._draw() < self._loss:
            return True
        return tick >= self._broken_tick

    def _draw(self) -> float:
        if not self._drawn:
            self._drawn = self._chance.random(_BLOCK).tolist()[::-1]
        return self._drawn.pop()


class MemberWords:
    """Messages that one member sends and receives."""

    def __init__(self, session: zenoh_link.Session, namespace: str) -> None:
        self.namespace, self.tick = namespace, 0  # namespace: of the member; tick: at which the vehicles are
        self._told = zenoh_link.fifo_subscriber(session, f"{namespace}/{TOLD}")
        self._heard = zenoh_link.blocking_publisher(session, f"{namespace}/{HEARD}")
        self._tick, self._payload = -1, _NOTHING
        self._last: int | None = None  # tick after which the process has left
        self._silent = False

    @property
    def is_set(self) -> bool:
        """Whether the onboard process has left before this tick, as it said itself."""
        self._poll()
        return self._last is not None and self._last < self.tick

    def take(self, silence: Silence, stop: Stop) -> bytes | None:
        """Wait for what the member tells at this tick, and return it; None: nothing.

        One that answers its vehicle and tells nothing is waited for once.

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
        """Hand out what the member hears with the next tick."""
        self._heard.put(joined(words), attachment=PAIR.pack(self.tick + 1, len(words)))

    def await_listener(self, stop: Stop) -> None:
        """Wait until the member hears: what is put before is lost, and would never come again.

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
