"""One item of the certificate: the claim, the room left at its worst point, and the remedy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class Need(Enum):
    """What a check is needed for."""

    FLIGHT = "flight"  # without it the set cannot work: the onboard process refuses it
    PROOF = "proof"  # without it nothing is promised of the worst case; it may still fly


@dataclass(frozen=True, slots=True)
class Check:
    """Outcome of one check.

    Attributes:
        name: short, unique.
        claim: what holds everywhere in the envelope if ``room`` is not negative.
        room: distance to the limit at the worst point.
        unit: of the room.
        worst: the worst point, in words.
        remedy: what to change if there is too little.
        need: what hangs on it.
    """

    name: str
    claim: str
    room: float
    unit: str
    worst: str
    remedy: str
    need: Need = Need.FLIGHT

    @property
    def proven(self) -> bool:
        """Whether the claim holds; a room that is NaN proves nothing."""
        return not math.isnan(self.room) and self.room >= 0.0

    @property
    def text(self) -> str:
        """The check as one line of an error."""
        return f"{self.name}: {self.worst}; short by {-self.room:.3g} {self.unit}: {self.remedy}"
