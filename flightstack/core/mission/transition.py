"""A change of phase as data, and the one text that says it: in the log, on the terminal, and back."""

from __future__ import annotations

import re
from typing import NamedTuple

from flightstack.core.memory import AbortWay
from flightstack.core.types import Phase

_PHASES, _WAYS = "|".join(Phase.__members__), "|".join(w.name.lower().replace("_", " ") for w in AbortWay)
_TIME = r"(?: *[0-9.]+ s  )?"
_CHANGE = rf"(?P<before>{_PHASES})(?: -> (?P<after>{_PHASES}))?"
_TEXT = re.compile(rf"{_TIME}{_CHANGE}: (?P<reason>.*?)(?: \((?P<way>{_WAYS})\))?", re.DOTALL)


class Transition(NamedTuple):
    """One change of phase.

    Attributes:
        before: phase until now.
        after: phase from now on; the same where an abort goes on in another way.
        reason: why, with the numbers behind it.
        way: in which an abort ends the flight; ``NONE`` for all other phases.
    """

    before: Phase
    after: Phase
    reason: str
    way: AbortWay = AbortWay.NONE

    @property
    def text(self) -> str:
        """As it stands in the log."""
        change = self.before.name if self.after is self.before else f"{self.before.name} -> {self.after.name}"
        way = f" ({self.way.name.lower().replace('_', ' ')})" if self.way is not AbortWay.NONE else ""
        return f"{change}: {self.reason}{way}"

    def told(self, now_s: float) -> str:
        """As it stands on the terminal, with the time on the stack's clock."""
        return f"{now_s:8.2f} s  {self.text}"


def parse(text: str) -> Transition | None:
    """Read ``Transition.text`` or ``Transition.told``; ``None`` for any other text."""
    found = _TEXT.fullmatch(text)
    if found is None:
        return None
    before, after, way = Phase[found["before"]], found["after"], found["way"]
    if after is None and way is None:  # only an abort changes within a phase
        return None
    return Transition(
        before,
        Phase[after] if after is not None else before,
        found["reason"],
        AbortWay[way.upper().replace(" ", "_")] if way is not None else AbortWay.NONE,
    )
