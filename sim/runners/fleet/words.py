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
        link = team.exchange
        self._loss, self._broken_tick = link.loss, math.ceil(link.broken_from_s * team.rate_hz - 1e-9)
        self._silent, self._apart = frozenset(link.silent), frozenset(link.apart)
        self._grid = TickGrid(team.rate_hz)
        self._ticks = max(1, math.ceil(team.exchange.delay_s * team.rate_hz - 1e-9))
        numbers = range(1, len(team.member) + 1)
        self._ways = [
            [_Losses(seed, teller, hearer) if teller != hearer else None for teller in numbers]
            for hearer in numbers
        ]
        self._under_way: list[deque[tuple[int, Any]]] = [deque() for _ in numbers]

    def __call__(self, tick: int, outputs: Sequence[Outputs | None]) -> list[tuple[Neighbour, ...]]:
        """Take the outputs of a tick; return the words that each member hears with the next one.

        Args:
            tick: number of the tick that all have flown.
            outputs: of all controllers; None where the flight is over.
        """
        heard = self.pass_on(tick, [None if each is None else each.own_word for each in outputs])
        arrive_s = self._grid.ns(tick + 1) / NS_PER_S
        return [tuple(word._replace(arrival_s=arrive_s) for word in words) for words in heard]

    def pass_on(self, tick: int, told: Sequence[T | None]) -> list[list[T]]:
        """Take what is told at a tick, in any form; return what each member hears with the next one.

        Args:
            tick: its number.
            told: by each member; None: nothing.
        """
        due = tick + self._ticks
        heard = []
        for hearer, (ways, under_way) in enumerate(zip(self._ways, self._under_way, strict=True), 1):
            for teller, (word, way) in enumerate(zip(told, ways, strict=True), 1):
                if way is None:
                    continue
                lost = way.draw() < self._loss  # drawn in each tick: what is told does not shift it
                lost = lost or (tick >= self._broken_tick and self._broken(teller, hearer))
                if word is not None and not lost:
                    under_way.append((due, word))
            here = []
            while under_way and under_way[0][0] <= tick + 1:
                here.append(under_way.popleft()[1])
            heard.append(here)
        return heard

    def _broken(self, teller: int, hearer: int) -> bool:
        """Whether nothing comes through from one member to another."""
        return teller in self._silent or (teller in self._apart) != (hearer in self._apart)


class _Losses:
    """Numbers between 0 and 1 for the words of one teller on their way to one hearer."""

    def __init__(self, seed: int, teller: int, hearer: int) -> None:
        self._chance = stream(seed_of(seed, hearer), f"words.{teller}")
        self._drawn: list[float] = []

    def draw(self) -> float:
        """Take the next one."""
        if not self._drawn:
            self._drawn = self._chance.random(_BLOCK).tolist()[::-1]
        return self._drawn.pop()
