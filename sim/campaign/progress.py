"""Progress bar of long computations, with counts of the results so far."""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from flightstack.common import hangup

if TYPE_CHECKING:
    from sim.campaign.rows import Row

_REFRESH_S = 0.1  # shortest wall time between two updates of the bar


class Bar:
    """Progress bar for a known number of results; it shows nothing if the output is not a terminal.

    It changes with each result, without a thread: a process with threads cannot fork its workers.
    """

    def __init__(self, console: Console, title: str, total: int | None) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
            TimeRemainingColumn(), TextColumn("{task.fields[counts]}", markup=False),
            console=console, disable=not console.is_terminal, auto_refresh=False,
        )  # fmt: skip
        self._drawn_s = 0.0
        self._task = self._progress.add_task(title, total=total, counts="")
        self._counts: Counter[str] = Counter()

    def __enter__(self) -> Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def row(self, row: Row) -> None:
        """Count a landing of a campaign."""
        self.done(row.outcome, *(["violations"] if row.violation else []))

    def done(self, *kinds: str) -> None:
        """Count one result, under each of these kinds.

        Raises CalledOffError: a signal arrived earlier, and a library suppressed its exception.
        """
        hangup.begun()
        self._counts.update(kinds)
        counts = "  ".join(f"{number} {name}" for name, number in sorted(self._counts.items()))
        self._progress.update(self._task, advance=1, counts=counts)
        if time.monotonic() - self._drawn_s >= _REFRESH_S:
            self._progress.refresh()
            self._drawn_s = time.monotonic()
