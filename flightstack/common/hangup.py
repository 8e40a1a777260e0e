"""Signals that ask a process to end: while it starts, and when its terminal goes away in flight."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

import click

from flightstack.common.text import plain

ASK = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)


class CalledOffError(KeyboardInterrupt):
    """A signal before the process handles signals itself: it unwinds the start, which ends the children."""


_COMPILER = "llvmlite"  # in the paths of the files whose callbacks drop exceptions
_AGAIN_S = 0.01
_came: list[CalledOffError] = []


def start() -> None:
    """From now on a signal raises ``CalledOffError``, until the process has handlers of its own.

    Main thread only. A signal is kept for ``begun``, since some callers of Python drop its exceptions.
    """
    _came.clear()
    for number in ASK:
        signal.signal(number, _call_off)
    on_hangup(_call_off)


def called_off() -> CalledOffError | None:
    """The newest signal that came while the process started, whatever became of its exception."""
    return _came[-1] if _came else None


def begun() -> None:
    """Call it once the process has handlers of its own.

    Raises CalledOffError: a signal came before, and its exception was dropped.
    """
    if _came:
        raise _came[-1]


def _call_off(number: int, frame: FrameType | None) -> None:
    """Raise; where the exception would be dropped, try again a little later."""
    if number != signal.SIGALRM:
        _came.append(CalledOffError(f"ended by {signal.Signals(number).name}"))
    while frame is not None:
        if _COMPILER in frame.f_code.co_filename:
            signal.signal(signal.SIGALRM, _call_off)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
            return
        frame = frame.f_back
    raise _came[-1]


class Stop:
    """First SIGTERM, SIGINT or SIGHUP: an orderly end. A second SIGTERM or SIGINT: an end at once."""

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0  # how often it was told

    @property
    def is_set(self) -> bool:
        """Whether an end was asked for."""
        return self.count > 0

    def ask(self) -> None:
        """Ask for an orderly end, as a first signal does."""
        self.count = max(self.count, 1)

    def install(self) -> Stop:
        """Take over the signals, once all is ready that takes long; main thread only.

        Raises CalledOffError: as of ``begun``.
        """
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._set)
        signal.signal(signal.SIGQUIT, signal.SIG_DFL)
        on_hangup(self._hang_up)
        begun()
        return self

    def _set(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.count += 1

    def _hang_up(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.ask()


def say(text: str) -> None:
    """Print a line."""
    click.echo(plain(text))


def on_hangup(handler: Callable[[int, FrameType | None], None]) -> None:
    """Call ``handler`` on SIGHUP; one that was told to ignore it (``nohup``) does. Main thread only."""
    number = getattr(signal, "SIGHUP", None)  # not on every system
    if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
        signal.signal(number, handler)
