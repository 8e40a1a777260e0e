"""Terminal output with Rich: tables, bars and styles, without markup in texts."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.segment import Segment

from flightstack.common import hangup
from flightstack.common.text import plain

_REFRESH_S = 0.1  # minimum wall time between two updates of a progress bar, s


class Terminal(Console):
    """Console that prints brackets, ``:name:`` and control characters literally."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render colours and cursor movements of Rich; show control characters of texts literally."""
        for segment in super().render(renderable, options):
            if segment.control or (text := plain(segment.text)) == segment.text:
                yield segment
            else:
                yield Segment(text, segment.style)


class Bar:
    """Progress bar for a known number of results; the bar is hidden if the output is not a terminal.

    The bar is drawn when a result arrives, not by a thread: a process with threads cannot fork its workers.
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

    def done(self, *kinds: str) -> None:
        """Count one result; each of its ``kinds`` has a counter of its own."""
        hangup.begun()  # a library can have suppressed the exception of a signal
        self._counts.update(kinds)
        counts = "  ".join(f"{number} {name}" for name, number in sorted(self._counts.items()))
        self._progress.update(self._task, advance=1, counts=counts)
        if time.monotonic() - self._drawn_s >= _REFRESH_S:
            self._progress.refresh()
            self._drawn_s = time.monotonic()
