"""Signals that end a process (at its start, in flight, at a closed terminal), and its standard streams.

Output is lost if its reader ends (``| head``, a closed terminal) or stops reading, if the disk is full, or if
the streams are closed at the start. A loss raises no exception, because a library could convert an exception
to an exit. No other file gets the descriptor of a standard stream.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import signal
import sys
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any

import click

from flightstack.common.text import plain

ASK = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT)


class CalledOffError(KeyboardInterrupt):
    """A signal arrived during the start, before the process has its own handlers."""


_COMPILER = "llvmlite"  # part of the path of files whose callbacks drop exceptions
_came: list[CalledOffError] = []


def start() -> None:
    """Let signals raise ``CalledOffError`` until the process has its own handlers. Main thread only."""
    _came.clear()
    for number in (*ASK, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN or number in ASK:
            signal.signal(number, _call_off)


def called_off() -> CalledOffError | None:
    """Return the error of the newest signal during the start, even if it was dropped; None: no signal."""
    return _came[-1] if _came else None


def begun() -> None:
    """Raise CalledOffError if a signal arrived during the start and its exception was dropped."""
    if _came:
        raise _came[-1]


def _call_off(number: int, frame: FrameType | None) -> None:
    """Raise CalledOffError; in a callback that would drop the exception, only store it for ``begun``."""
    _came.append(CalledOffError(f"ended by {signal.Signals(number).name}"))
    while frame is not None:
        if _COMPILER in frame.f_code.co_filename:
            return
        frame = frame.f_back
    raise _came[-1]


class Stop:
    """Requests to end a process: in order after a first signal, at once after a second SIGTERM or SIGINT."""

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
            signal.signal(number, lambda *_, run=handler: run())


# errors of a stream whose reader has ended; these errors are permanent, others (ENOSPC) can be temporary
_GONE = (errno.EPIPE, errno.EIO, errno.EBADF)
_PART = select.PIPE_BUF  # number of bytes that a pipe accepts without blocking if ``select`` reports it
_NUMBERS = {"stdout": 1, "stderr": 2}


class Stream(io.FileIO):
    """Standard stream that never raises an exception."""

    waits = True  # whether to wait for a slow reader; False in flight
    lost: OSError | None = None  # newest error that lost standard output; None: no output was lost

    def write(self, data: Any) -> int:
        """Write or drop bytes; return their number."""
        size, number = memoryview(data).nbytes, self.fileno()
        part = data if Stream.waits else memoryview(data).cast("B")[:_PART]
        try:
            if not Stream.waits and not select.select((), (number,), (), 0.0)[1]:
                return size
            written = super().write(part)
        except OSError as error:
            if number == _NUMBERS["stdout"]:
                Stream.lost = error
            if error.errno in _GONE:  # libraries and children then write to the null device
                with contextlib.suppress(OSError), open(os.devnull, "wb") as nothing:  # noqa: PTH123
                    os.dup2(nothing.fileno(), number)
            return size
        return size if written is None else written  # None: the stream is non-blocking and full


def guard() -> bool:
    """Replace the standard streams; call this before any file is opened.

    Streams that a test has replaced are not changed. Return whether standard output is replaced now.
    """
    Stream.lost = None  # a forked process inherits the value of its parent
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # the stream is closed: the next opened file would get its descriptor
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name, number in _NUMBERS.items():
        old = getattr(sys, name)
        if old is not None and (_number(old) != number or isinstance(_raw(old), Stream)):
            continue
        raw = Stream(number, "w", closefd=False)
        at_once = old is not None and old.write_through
        stream = io.TextIOWrapper(
            raw if at_once else io.BufferedWriter(raw),
            encoding=old.encoding if old is not None else "utf-8",
            # characters outside the terminal's encoding must not raise an error
            errors=old.errors if old is not None and old.errors != "strict" else "backslashreplace",
            line_buffering=number == 2 or (old is not None and old.line_buffering),
            write_through=at_once,
        )
        setattr(sys, name, stream)
    return isinstance(_raw(sys.stdout), Stream)


def never_wait() -> None:
    """From now on drop output that is not read, so that a flight does not wait for a reader."""
    Stream.waits = False


def problem() -> str | None:
    """Return why standard output is incomplete; None: it is complete, or the reader ended."""
    sys.stdout.flush()
    return Stream.lost.strerror if Stream.lost is not None and not reader_gone() else None


def reader_gone() -> bool:
    """Whether the reader of standard output has ended."""
    return Stream.lost is not None and Stream.lost.errno in _GONE


def _raw(stream: object) -> object:
    """Return the raw file of a text stream."""
    buffer = getattr(stream, "buffer", None)
    return getattr(buffer, "raw", buffer)


def _number(stream: io.TextIOBase) -> int | None:
    try:
        return stream.fileno()
    except (OSError, ValueError):  # the stream has no descriptor, or is closed
        return None
