"""Keeps the time of a log while it is played: rate, pause, single steps; knows nothing of what is played."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any, TypeVar

T = TypeVar("T")

SLICE_S = 0.05  # s of wall time between looks at keys and sockets
TOGGLE, STEP = " \r\n", "s"


class Player:
    """Plays timed items at their distances in time.

    Attributes:
        paused: whether time stands still.
    """

    def __init__(
        self,
        rate: float,
        *,
        paused: bool = False,
        key: Callable[[float], str],
        idle: Callable[[], None],
        stopped: Callable[[], bool],
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        """Set up.

        Args:
            rate: seconds of the log in a second of wall time, > 0.
            paused: begin with time standing still.
            key: waits at most so many seconds and returns the key that was pressed, "" for none.
            idle: called at least every ``SLICE_S`` while waiting.
            stopped: whether to end.
            monotonic: the wall's clock.
        """
        self._rate, self._key, self._idle, self._stopped = rate, key, idle, stopped
        self._monotonic = monotonic
        self._at_s: float | None = None  # place in the log at wall time _since_s
        self._since_s = 0.0
        self._step = False
        self.paused = paused

    def play(self, items: Iterable[tuple[float, T]], send: Callable[[T], None]) -> int:
        """Send each item when its time has come; how many were sent.

        Args:
            items: (time in the log in s, item) in order.
            send: takes an item.
        """
        sent = 0
        self._at_s = None
        for at_s, item in items:
            if not self._wait(at_s):
                break
            send(item)
            sent += 1
        return sent

    def _wait(self, at_s: float) -> bool:
        """Wait for a place in the log; False when it is time to end."""
        if self._at_s is None:
            self._at_s, self._since_s = at_s, self._monotonic()
        while not self._stopped():
            wait_s = SLICE_S
            if self._step:
                self._step = False
                self._at_s, self._since_s = at_s, self._monotonic()
                return True
            if not self.paused:
                wait_s = (at_s - self._place()) / self._rate
                if wait_s <= 0.0:
                    return True
            self._idle()
            self._pressed(self._key(min(wait_s, SLICE_S)))
        return False

    def _place(self) -> float:
        assert self._at_s is not None
        return self._at_s + (self._monotonic() - self._since_s) * self._rate

    def _pressed(self, key: str) -> None:
        if key and key in TOGGLE:
            if not self.paused:
                self._at_s = self._place()
            self._since_s = self._monotonic()
            self.paused = not self.paused
        elif key == STEP and self.paused:
            self._step = True


def no_keys(timeout_s: float) -> str:
    """Wait without a keyboard; no key is ever pressed."""
    time.sleep(timeout_s)
    return ""


class Terminal:
    """Single keys of the terminal, without waiting for the end of a line."""

    def __init__(self) -> None:
        self._before: list[Any] = []

    def __enter__(self) -> Terminal:
        """Switch the terminal over."""
        self._before = termios.tcgetattr(sys.stdin)
        tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Give it back as it was."""
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def key(self, timeout_s: float) -> str:
        """Wait at most so long for a key."""
        if not select.select([sys.stdin], [], [], timeout_s)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 1).decode(errors="replace")  # unbuffered: select must see the rest
