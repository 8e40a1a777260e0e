"""Differences between recorded and replayed values, and their count."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

SHOWN_MAX = 10  # differences kept; the others are counted


@dataclass(frozen=True, slots=True)
class TickDifference:
    """One value that differs."""

    topic: str  # topic of the recorded value
    tick: int  # tick number
    field: str  # dotted name as in the message definition
    recorded: str  # value in the log, as text
    replayed: str  # value of this replay, as text

    def __str__(self) -> str:
        return (
            f"{self.topic} tick {self.tick} {self.field}: recorded {self.recorded}, replayed {self.replayed}"
        )


@dataclass
class Tally:
    """Differences of one kind: their number, and the first ones."""

    count: int = 0
    ticks: int = 0  # that hold one
    first: list[TickDifference] = field(default_factory=list)

    def add(self, found: Iterable[TickDifference]) -> None:
        before = self.count
        for each in found:
            self.count += 1
            if len(self.first) < SHOWN_MAX:
                self.first.append(each)
        self.ticks += self.count > before
