"""One check of the certificate: the claim, the distance to its limit at the worst point, and the remedy."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Need(Enum):
    """Purpose of a check."""

    FLIGHT = "flight"  # necessary for a flight: if refuted, the onboard process rejects the configuration
    PROOF = "proof"  # necessary for the worst-case guarantee: if refuted, a flight is still possible


PROOF = Need.PROOF


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check of the certificate.

    Attributes:
        name: short name, unique among the checks of a configuration.
        claim: statement that is true in the whole envelope if ``room`` is not negative.
        room: distance to the limit at the worst point.
        unit: unit of ``room``.
        worst: text that describes the worst point.
        remedy: change of the configuration if the room is negative.
        need: consequence of a negative room.
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
        """Whether the claim holds; a NaN in ``room`` proves nothing."""
        return not math.isnan(self.room) and self.room >= 0.0

    @property
    def text(self) -> str:
        """The check as one line of an error message."""
        return f"{self.name}: {self.worst}; short by {-self.room:.3g} {self.unit}: {self.remedy}"


def worst(found: Iterable[Check]) -> list[Check]:
    """Return for each name the check with the smallest room, in the order of the first check of each name."""
    by_name: dict[str, list[Check]] = {}
    for check in found:
        by_name.setdefault(check.name, []).append(check)
    return [
        min(each, key=lambda check: -math.inf if math.isnan(check.room) else check.room)
        for each in by_name.values()
    ]
