"""Handling of the signals that end a process: during its start, while it runs, and at a closed terminal."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from functools import partial
from types import FrameType

import click

from flightstack.common.text import plain

ASK = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)


class CalledOffError(KeyboardInterrupt):
    """A signal arrived during the start, before the process has its own handlers."""


_COMPILER = "llvmlite"  # callbacks in files with this part in their path drop exceptions
_AGAIN_S = 0.01
_came: list[CalledOffError] = []


def start() -> None:
    """Let signals raise ``CalledOffError`` until the process has its own handlers. Main thread only.

    A signal is also stored for ``begun``, because some callbacks drop exceptions.
    """
    _came.clear()
    for number in (*ASK, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN or number in ASK:
            signal.signal(number, _call_off)


def called_off() -> CalledOffError | None:
    """Return the error of the newest signal during the start, even if it was dropped; None: no signal."""
    return _came[-1] if _came else None


def begun() -> None:
    """End the handling of ``start``. Raises CalledOffError: a signal arrived whose exception was dropped."""
    if _came:
        raise _came[-1]


def _call_off(number: int, frame: FrameType | None) -> None:
    """Raise the exception; inside a callback that would drop it, try again a little later."""
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
    """Requests to end a process: the first signal in order, a second SIGTERM or SIGINT immediately."""

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0  # number of received signals

    @property
    def is_set(self) -> bool:
        """Whether a signal or ``ask`` has requested the end."""
        return self.count > 0

    def ask(self) -> None:
        """Request an orderly end, with the effect of a first signal."""
        self.count = max(self.count, 1)

    def install(self) -> Stop:
        """Install the handlers after the slow part of a start; main thread only. Raises as ``begun`` does."""
        signal.signal(signal.SIGQUIT, signal.SIG_DFL)
        handle({signal.SIGTERM: self._count, signal.SIGINT: self._count, signal.SIGHUP: self.ask})
        begun()
        return self

    def _count(self) -> None:
        self.count += 1


def say(text: str) -> None:
    click.echo(plain(text))


def handle(handlers: Mapping[signal.Signals, Callable[[], object]]) -> None:
    """Install a function for each signal; an ignored SIGHUP (``nohup``) remains ignored. Main thread only."""
    for number, handler in handlers.items():
        if number is not signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, partial(_call, handler))


def _call(handler: Callable[[], object], number: int, frame: FrameType | None) -> None:
    del number, frame
    handler()
