"""What a run found, as text and as the table of docs/how_it_works/safety_core.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tests.mutation import equivalent
from tests.mutation.run import Outcome, Result
from tests.mutation.targets import ROOT, TARGETS

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
    return equivalent.reason(result.module, result.mutant.key) is not None


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
        for entry in equivalent.EQUIVALENT
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
