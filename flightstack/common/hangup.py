"""The terminal goes away in flight: a closed window, a lost SSH connection."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable
from types import FrameType

import click

from flightstack.common.text import plain


class Stop:
    """SIGTERM and SIGINT: the first asks for an orderly end, the second ends at once. SIGHUP is a first one.

    Attributes:
        count: how often it was told.
    """

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0

    @property
    def is_set(self) -> bool:
        """Whether an end was asked for."""
        return self.count > 0

    def ask(self) -> None:
        """Ask for an orderly end, as a first signal does."""
        self.count = max(self.count, 1)

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
        self.ask()


def say(text: str) -> None:
    """Print a line, unless nobody listens any more: that must not end a flight."""
    with contextlib.suppress(OSError):
        click.echo(plain(text))


def on_hangup(handler: Callable[[int, FrameType | None], None]) -> None:
    """Call ``handler`` on SIGHUP; one that was told to ignore it (``nohup``) does. Main thread only."""
    number = getattr(signal, "SIGHUP", None)  # not on every system
    if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
        signal.signal(number, handler)
