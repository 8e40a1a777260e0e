"""The exchange of ``land_team``: each member tells all others one word a tick; words come late and get lost.

A word told at tick k is there at tick k + 1 at the earliest. Whether one is lost depends on the team's seed,
on who tells and on who hears, so that it does not change when members are added.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, TypeVar

from flightstack.core.controller import Outputs
from flightstack.core.types import Neighbour
from sim.chance import member as seed_of
from sim.chance import stream
from sim.clock import NS_PER_S, TickGrid
from sim.scenarios.team import TeamScenario

T = TypeVar("T")

_BLOCK = 256  # random numbers drawn at once


class Words:
    """Passes words on, as ``TeamScenario.exchange`` has it.

    Args:
        team: number of members, ticks, delay and loss.
        seed: of the team.
    """

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

        Args:
            tick: number of the tick that all have flown.
            outputs: of all controllers; None where the flight is over.
        """
        arrive_s = self._grid.ns(tick + self._ticks) / NS_PER_S
        told = [None if each is None else each.own_word for each in outputs]
        on_time = [word and word._replace(arrival_s=arrive_s) for word in told]
        return [tuple(words) for words in self.pass_on(tick, on_time)]

    def pass_on(self, tick: int, told: Sequence[T | None]) -> list[list[T]]:
        """Take what is told at a tick, in any form; return what each member hears with the next one.

        Args:
            tick: its number.
            told: by each member; None: nothing.
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
