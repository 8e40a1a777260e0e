"""What a run found, as text and as a table of a page; the mutants that no test can notice, with reasons."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from tests.mutation.mutants import ROOT, TARGETS
from tests.mutation.run import Outcome, Result


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

EQUIVALENT = tuple(
    Equivalent(f"flightstack.core.{module}", key, why)
    for module, key, why in (
        ("safety.gate", "Gate._verdict: arithmetic: vx + vy...", FINITE),
        ("safety.gate", "Gate._keeps_promise: return: return False -> return None...", "both are false"),
        ("safety.gate", "Gate._keeps_promise: arithmetic: now + then...", FINITE),
        ("safety.gate", "Gate._keeps_promise: boundary: missing_m <= 0.0 -> ...",
         "the barrier is asked then, and what it allows is never negative"),
        ("safety.barrier", "linearisation_bound: boundary: moved_m <= gap -> ...", SAME_VALUE),
        ("safety.barrier", "linearisation_bound: boundary: moved_m < r + d -> ...", SAME_VALUE),
        ("mission.phases", "Condition: arithmetic: 1 << 0 -> 1 >> 0", "shifted by nothing"),
        ("safety.projection", "projected: boundary: value >= b -> ...", SAME_POINT),
        ("safety.projection", "_multiplier: boundary: gi > 0.0 -> ...", "zero is left out before"),
        ("safety.projection", "_multiplier: boundary: stop <= 0.0 -> ...", SAME_POINT),
        ("safety.projection", "_multiplier: boundary: start > 0.0 -> ...", SAME_POINT),
        ("safety.projection", "_multiplier: boundary: slope > 0.0 -> slope >= 0.0", SAME_POINT),
        ("safety.projection", "_multiplier: boundary: value + slope * (when - at) >= b -> ...", SAME_POINT),
        ("safety.qp_filter", "SafetyFilter.__init__: negation: -1.0 -> 1.0", OVERWRITTEN),
        ("safety.qp_filter", "SafetyFilter.__init__: constant: 1.0 -> ...", OVERWRITTEN),
        ("safety.qp_filter", "SafetyFilter.solve: arithmetic: bound + gx...", FINITE),
        ("safety.qp_filter", "SafetyFilter.solve: arithmetic: finite + upper[0]...", FINITE),
        ("safety.qp_filter", "SafetyFilter._osqp: arithmetic: x + y...", FINITE),
    )
)  # fmt: skip


def reason(module: str, key: str) -> str | None:
    """Why a mutant is equivalent; ``None``: it is not."""
    for entry in EQUIVALENT:
        if entry.names(module, key):
            return entry.reason
    return None


DOCUMENT = ROOT / "docs" / "how_it_works" / "safety_core.md"
BEGIN, END = "<!-- mutation table: python -m tests.mutation -->", "<!-- end of the mutation table -->"
NOTICED = (Outcome.KILLED, Outcome.TIMEOUT)


@dataclass(frozen=True)
class Tally:
    """Numbers of one module, or of all."""

    name: str
    total: int
    killed: int
    timeout: int
    equivalent: int  # survived, and listed with the reason
    survived: int  # survived, and nobody knows why
    infra_error: int

    @property
    def score(self) -> float:
        """Share noticed of those that can be noticed; an infra error counts as not noticed."""
        possible = self.total - self.equivalent
        return (self.killed + self.timeout) / possible if possible else 1.0


def tally(name: str, results: Sequence[Result]) -> Tally:
    """Count outcomes."""
    count = Counter(r.outcome for r in results)
    listed = sum(r.outcome is Outcome.SURVIVED and is_listed(r) for r in results)
    return Tally(
        name,
        len(results),
        count[Outcome.KILLED],
        count[Outcome.TIMEOUT],
        listed,
        count[Outcome.SURVIVED] - listed,
        count[Outcome.INFRA_ERROR],
    )


def is_listed(result: Result) -> bool:
    """The mutant is said to be equivalent."""
    return reason(result.module, result.mutant.key) is not None


def surprises(results: Sequence[Result]) -> list[str]:
    """Mutants that survived unlisted, that say nothing, or that are listed and were noticed."""
    found = []
    for r in results:
        at = f"{r.module}:{r.mutant.line}: {r.mutant.key}"
        if r.outcome is Outcome.SURVIVED and not is_listed(r):
            found.append(f"survived: {at}")
        elif r.outcome is Outcome.INFRA_ERROR:
            found.append(f"infra error: {at}\n{r.text[-2000:]}")
        elif r.outcome in NOTICED and is_listed(r):
            found.append(f"listed as equivalent, but {r.outcome.value}: {at}")
    return found


def stale(results: Sequence[Result]) -> list[str]:
    """Entries of the list of equivalents that name no mutant of a full run."""
    return [
        f"listed as equivalent, but there is no such mutant: {entry.module}: {entry.key}"
        for entry in EQUIVALENT
        if not any(entry.names(r.module, r.mutant.key) for r in results)
    ]


def table(results: Sequence[Result]) -> str:
    """Markdown: one row a module, and the sum."""
    rows = [tally(m, [r for r in results if r.module == m]) for m in TARGETS]
    rows = [row for row in rows if row.total]
    rows.append(tally("all", results))
    head = "| module | mutants | killed | timeout | equivalent | survived | infra error | noticed |"
    lines = [head, "|---|--:|--:|--:|--:|--:|--:|--:|"]
    for t in rows:
        numbers = (t.total, t.killed, t.timeout, t.equivalent, t.survived, t.infra_error)
        name = t.name.removeprefix("flightstack.")
        lines.append(f"| {name} | {' | '.join(map(str, numbers))} | {100.0 * t.score:.1f} % |")
    return "\n".join(lines)


def write(results: Sequence[Result]) -> None:
    """Put the table into the document, between its two marks.

    Raises:
        ValueError: the marks are not there.
    """
    text = DOCUMENT.read_text()
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise ValueError(f"{DOCUMENT}: needs the lines {BEGIN!r} and {END!r} once each, around the table")
    before, rest = text.split(BEGIN)
    DOCUMENT.write_text(f"{before}{BEGIN}\n{table(results)}\n{END}{rest.split(END)[1]}")
