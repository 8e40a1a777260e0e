"""Where a flight is drawn: a Rerun recording that takes a whole log, or rows piece by piece in flight."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import rerun as rr

from logs.derive.markers import Path
from logs.view.blueprint import FLIGHT, LOG_TIME
from logs.view.read import Ints


class Canvas:
    """A recording stream with what it has to remember between two pieces of a flight.

    Attributes:
        stream: the recording.
        paths: where vehicle and target have been, by entity.
        phase: that was shown last.

    Args:
        stream: the recording.
        origin_ns: log time at which the time line of the flight begins.
    """

    def __init__(self, stream: rr.RecordingStream, origin_ns: int) -> None:
        self.stream = stream
        self.paths: dict[str, Path] = {}
        self.phase: int | None = None
        self._origin_ns = origin_ns
        self._styled: set[str] = set()
        self._slots: dict[str, int] = {}

    def style(self, entity: str, archetype: rr.AsComponents) -> None:
        """Send what does not change with time; the first time only."""
        if entity not in self._styled:
            self._styled.add(entity)
            self.stream.log(entity, archetype, static=True)

    def columns(self, entity: str, at_ns: Ints, columns: Iterable[Any]) -> None:
        """Send values of an entity at log times in ns."""
        self.stream.send_columns(
            entity,
            (
                rr.TimeColumn(FLIGHT, duration=(at_ns - self._origin_ns).astype("timedelta64[ns]")),
                rr.TimeColumn(LOG_TIME, timestamp=at_ns.astype("datetime64[ns]")),
            ),
            columns,
        )

    def due(self, name: str, period_ns: int, at_ns: int) -> bool:
        """Whether this is the first time in a period, by name."""
        slot = at_ns // period_ns
        if self._slots.get(name) == slot:
            return False
        self._slots[name] = slot
        return True
