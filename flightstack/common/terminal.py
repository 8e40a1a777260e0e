"""Terminal output with Rich: tables, bars and styles, without markup in texts."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from flightstack.common.text import plain


class Terminal(Console):
    """Console that prints brackets, ``:name:`` and control characters literally."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render only colours and cursor movements that Rich itself makes."""
        for segment in super().render(renderable, options):
            if segment.control or (text := plain(segment.text)) == segment.text:
                yield segment
            else:
                yield Segment(text, segment.style)
