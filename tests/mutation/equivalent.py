"""Changes that no test can notice, because the program does the same; each with the reason.

An entry is a module, a mutant's key, or the beginning of several, and why. A run says if one of them is
killed after all, and if an entry names no mutant any more.
"""

from __future__ import annotations

from typing import NamedTuple


class Equivalent(NamedTuple):
    """Mutants that change nothing; a key that ends with three dots is the beginning of theirs."""

    module: str
    key: str
    reason: str

    def names(self, module: str, key: str) -> bool:
        """Whether this mutant is meant."""
        start = self.key.removesuffix("...")
        return module == self.module and (key.startswith(start) if start != self.key else key == start)


FINITE = "a sum is finite only if all its terms are, whatever their signs"
OVERWRITTEN = "written anew in every tick before the solver reads it"
SAME_VALUE = "at equality both cases have the same value"
SAME_POINT = "at equality both ways lead to the same point of the box"

EQUIVALENT = (
    Equivalent("flightstack.core.safety.gate", "Gate._verdict: arithmetic: vx + vy...", FINITE),
    Equivalent(
        "flightstack.core.safety.gate",
        "Gate._keeps_promise: return: return False -> return None...",
        "both are false",
    ),
    Equivalent("flightstack.core.safety.gate", "Gate._keeps_promise: arithmetic: now + then...", FINITE),
    Equivalent(
        "flightstack.core.safety.gate",
        "Gate._keeps_promise: boundary: missing_m <= 0.0 -> ...",
        "the barrier is asked then, and what it allows is never negative",
    ),
    Equivalent(
        "flightstack.core.safety.barrier",
        "Barrier.linearisation_bound_m: boundary: moved_m <= gap -> ...",
        SAME_VALUE,
    ),
    Equivalent(
        "flightstack.core.safety.barrier",
        "Barrier.linearisation_bound_m: boundary: moved_m < r + d -> ...",
        SAME_VALUE,
    ),
    Equivalent(
        "flightstack.core.mission.phases", "Condition: arithmetic: 1 << 0 -> 1 >> 0", "shifted by nothing"
    ),
    Equivalent(
        "flightstack.core.safety.projection",
        "project: constant: True -> False #2",
        "the first zip has refused it",
    ),
    Equivalent("flightstack.core.safety.projection", "project: boundary: value >= b -> ...", SAME_POINT),
    Equivalent(
        "flightstack.core.safety.projection", "project: boundary: gi > 0.0 -> ...", "zero is left out before"
    ),
    Equivalent("flightstack.core.safety.projection", "project: boundary: stop <= 0.0 -> ...", SAME_POINT),
    Equivalent("flightstack.core.safety.projection", "project: boundary: start > 0.0 -> ...", SAME_POINT),
    Equivalent(
        "flightstack.core.safety.projection", "project: boundary: slope > 0.0 -> slope >= 0.0", SAME_POINT
    ),
    Equivalent(
        "flightstack.core.safety.projection",
        "project: boundary: value + slope * (when - at) >= b -> ...",
        SAME_POINT,
    ),
    Equivalent(
        "flightstack.core.safety.qp_filter", "SafetyFilter.__init__: negation: -1.0 -> 1.0", OVERWRITTEN
    ),
    Equivalent(
        "flightstack.core.safety.qp_filter", "SafetyFilter.__init__: constant: 1.0 -> ...", OVERWRITTEN
    ),
    Equivalent("flightstack.core.safety.qp_filter", "SafetyFilter.solve: arithmetic: bound + gx...", FINITE),
    Equivalent(
        "flightstack.core.safety.qp_filter", "SafetyFilter.solve: arithmetic: finite + upper[0]...", FINITE
    ),
    Equivalent("flightstack.core.safety.qp_filter", "SafetyFilter._osqp: arithmetic: x + y...", FINITE),
)


def reason(module: str, key: str) -> str | None:
    """Why a mutant is equivalent; ``None``: it is not."""
    for entry in EQUIVALENT:
        if entry.names(module, key):
            return entry.reason
    return None
