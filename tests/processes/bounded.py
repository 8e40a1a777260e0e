"""Waits, with time-outs, for a line, all lines or the end of a process that a test started."""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from tests.processes.started import Started

PATIENCE_S = 60.0  # time-out of the start of a process on an overloaded machine, s
AT_ONCE_S = 10.0  # time-out of an immediate action, s; a process took up to 3.2 s to end


T = TypeVar("T")


def wait_for(done: Callable[[], T], what: str = "it", within_s: float = PATIENCE_S) -> T:
    """Poll until another thread or process makes ``done()`` return a true value; return this value."""
    until_s = time.monotonic() + within_s
    while not (found := done()):
        assert time.monotonic() < until_s, f"{what} did not come"
        time.sleep(0.001)
    return found


def line_of(stream: IO[Any], within_s: float = PATIENCE_S) -> str:
    """Return the next line that a process writes, as ``readline`` does; empty at the end of the output.

    The bytes are read one by one without the stream's buffer, so that ``communicate`` gets all later bytes.

    Raises AssertionError: no complete line arrived in time.
    """
    until_s, text = time.monotonic() + within_s, b""
    while not text.endswith(b"\n"):
        left_s = max(0.0, until_s - time.monotonic())
        assert select.select([stream], [], [], left_s)[0], f"no line within {within_s:g} s: {text!r}"
        byte = os.read(stream.fileno(), 1)
        if not byte:
            break
        text += byte
    return text.decode(errors="replace")


def lines_of(stream: IO[Any], within_s: float) -> Iterator[str]:
    """Yield the lines that a process writes, up to its end.

    Raises AssertionError: the process has not ended ``within_s`` after the call.
    """
    until_s = time.monotonic() + within_s
    while line := line_of(stream, until_s - time.monotonic()):
        yield line


def killed(child: subprocess.Popen[Any] | Started, within_s: float = PATIENCE_S) -> str:
    """Kill a process if it has not ended; return its unread output.

    If a child of the process keeps the pipes open, the reading ends by a time-out and the pipes are closed.
    """
    child.kill()
    said = None
    if child.stdout is not None and not child.stdout.closed:
        with contextlib.suppress(subprocess.TimeoutExpired):
            said = child.communicate(timeout=within_s)[0]
    for pipe in filter(None, (child.stdin, child.stdout, child.stderr)):
        pipe.close()
    child.wait(within_s)
    return said.decode(errors="replace") if isinstance(said, bytes) else said or ""


def gone(pid: int, within_s: float = PATIENCE_S) -> bool:
    """Wait for the end of a process with a time-out; return whether the process has ended."""

    def ended() -> bool:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except (FileNotFoundError, ProcessLookupError):  # the process may end while the file is read
            return True
        return state == "Z"

    with contextlib.suppress(AssertionError):
        return wait_for(ended, within_s=within_s)
    return False
