"""The terminal goes away in flight: a closed window, a lost SSH connection."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable
from types import FrameType

import click


def say(text: str) -> None:
    """Print a line, unless nobody listens any more: that must not end a flight."""
    with contextlib.suppress(OSError):
        click.echo(text)


def on_hangup(handler: Callable[[int, FrameType | None], None]) -> None:
    """Call ``handler`` on SIGHUP; one that was told to ignore it (``nohup``) does. Main thread only."""
    number = getattr(signal, "SIGHUP", None)  # not on every system
    if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
        signal.signal(number, handler)
