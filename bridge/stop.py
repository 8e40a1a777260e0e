"""What ends a bridge: a vehicle may be flying by it."""

from __future__ import annotations

import signal
from types import FrameType

from flightstack.common.hangup import on_hangup


class Stop:
    """SIGTERM and SIGINT: the first asks for an orderly end, the second ends at once. SIGHUP is a first one.

    Attributes:
        count: how often it was told.
    """

    def __init__(self) -> None:
        self.count = 0

    def install(self) -> Stop:
        """Take over the signals; main thread only."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._set)
        on_hangup(self._hang_up)
        return self

    def _set(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.count += 1

    def _hang_up(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.count = max(self.count, 1)
