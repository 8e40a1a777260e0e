"""The progress bar of verbs that compute for long, with a count of what has come so far."""

from __future__ import annotations

import time
from collections import Counter
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from sim.campaign.rows import Row

_REFRESH_S = 0.1  # s of wall time between two times that it is drawn, at least


class Bar:
    """Progress of a known number of things; nothing is shown where the output is no terminal.

    It is drawn when something is done, and needs no thread: a process with threads cannot have workers that
    go on with what it has loaded (``Forked``).
    """

    def __init__(self, console: Console, title: str, total: int | None) -> None:
        self._progress = Progress(
            TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[told]}", markup=False), console=console, disable=not console.is_terminal,
            auto_refresh=False,
        )  # fmt: skip
        self._drawn_s = 0.0
        self._task = self._progress.add_task(title, total=total, told="")
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
        """Count one thing, under each of these kinds."""
        self._counts.update(kinds)
        told = "  ".join(f"{number} {name}" for name, number in sorted(self._counts.items()))
        self._progress.update(self._task, advance=1, told=told)
        if time.monotonic() - self._drawn_s >= _REFRESH_S:
            self._progress.refresh()
            self._drawn_s = time.monotonic()
