"""The clock of a simulator that paces itself, shared with the processes of its run through a file.

The simulator writes its time, and the others use it instead of the wall's. Each of them writes until when it
waits, and the simulator does not pass that time before: a busy machine slows down all of them together, and
none falls behind. The file holds integers of 64 bits: Unix time of the clock's zero, simulated time, and for
each follower the simulated time until which it waits, all in nanoseconds.
"""

from __future__ import annotations

import mmap
import time
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Protocol

from flightstack.common.pacing import FastClock

_ZERO, _NOW, _FIRST = 0, 1, 2  # places in the file
_ABSENT = -1  # a follower that has not begun, or was given up
_NS = 1_000_000_000
_ROUNDING_NS = 1_000  # more than seconds in floats are off by; less than any step
_PAUSE_S = 50e-6  # s between two looks; with the system's timer slack about 0.1 ms
_FOLLOWER_MAX_S = 0.5  # s of wall time that the simulator waits for a follower, which may have been killed
_STALL_MAX_S = 2.5  # s of wall time without a step, after which followers go on by the wall's clock


class Follower(IntEnum):
    """Who may follow: the place of each in the file."""

    ONBOARD = 0
    TARGET = 1


_SIZE = 8 * (_FIRST + len(Follower))


def _opened(path: Path) -> memoryview:
    with path.open("r+b") as file:
        return memoryview(mmap.mmap(file.fileno(), _SIZE)).cast("q")


class SimulationClock:
    """The simulator's end: writes the time, and waits for those who live by it.

    ``path``: file of the clock; made anew.
    """

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(_SIZE))
        self._cells = _opened(path)
        self._cells[_ZERO] = time.time_ns()
        for follower in Follower:
            self._cells[_FIRST + follower] = _ABSENT

    def unix_ns(self) -> int:
        """Unix time of the run: that of the clock's zero, and simulated time since."""
        return self._cells[_ZERO] + self._cells[_NOW]

    def advance(self, now_ns: int, stopped: Callable[[], bool]) -> None:
        """Set the time, then wait until every follower has done what was due.

        One that has not within half a second of wall time is not waited for until it is back.

        ``now_ns``: simulated time; never less than before; ``stopped``: ends the wait.
        """
        cells = self._cells
        cells[_NOW] = now_ns
        until_s: float | None = None
        while not stopped():
            behind = [f for f in Follower if _ABSENT < cells[_FIRST + f] <= now_ns]
            if not behind:
                return
            wall_s = time.monotonic()
            if until_s is None:
                until_s = wall_s + _FOLLOWER_MAX_S
            elif wall_s > until_s:
                for follower in behind:
                    cells[_FIRST + follower] = _ABSENT
                return
            time.sleep(_PAUSE_S)


class FollowedClock:
    """A follower's end, with the methods that a pacer needs.

    A simulator that does not step for 2.5 s has stopped: then time passes as on the wall's clock, so that the
    follower's own time-outs still end. The same holds when the process is to end.

    ``path``: file of the clock; ``follower``: who this is; ``stopped``: whether the process is to end.
    Raises OSError: there is no such file; ValueError: it is not the file of a clock.
    """

    def __init__(self, path: Path, follower: Follower, stopped: Callable[[], bool] = lambda: False) -> None:
        size = path.stat().st_size
        if size != _SIZE:
            raise ValueError(f"{path} is not a simulator's clock: it has {size} bytes, a clock has {_SIZE}")
        self._cells, self._place, self._stopped = _opened(path), _FIRST + follower, stopped
        self._seen_ns, self._moved_s = self._cells[_NOW], time.monotonic()
        self._ahead_s = 0.0  # of simulated time, by stalls that are over
        self._stall_s = 0.0  # by the present one
        self._least_s = 0.0  # to which it has slept

    def monotonic(self) -> float:
        """Simulated time, s."""
        now_ns, wall_s = self._cells[_NOW], time.monotonic()
        if now_ns != self._seen_ns:
            self._seen_ns, self._moved_s = now_ns, wall_s
            self._ahead_s += self._stall_s
            self._stall_s = 0.0
        else:
            allowed_s = 0.0 if self._stopped() else _STALL_MAX_S
            self._stall_s = max(self._stall_s, wall_s - self._moved_s - allowed_s)
        return max(self._least_s, now_ns / _NS + self._ahead_s + self._stall_s)

    def sleep(self, seconds: float) -> None:
        """Let the simulator go on for so many seconds, and wait until it has."""
        until_s = self.monotonic() + seconds
        # The simulator waits when it has come so far: then this must have, too, whatever was rounded.
        until_ns = int((until_s - self._ahead_s - self._stall_s) * _NS) - _ROUNDING_NS
        self._cells[self._place] = until_ns
        while self._cells[_NOW] < until_ns and self.monotonic() < until_s:
            time.sleep(_PAUSE_S)
        self._least_s = until_s

    def unix_ns(self) -> int:
        """Unix time of the run, the same for all its processes."""
        return self._cells[_ZERO] + round(self.monotonic() * _NS)


class Clock(Protocol):
    """What a pacer in real time needs."""

    def monotonic(self) -> float:
        """Seconds since some time in the past."""

    def sleep(self, seconds: float) -> None:
        """Sleep so many seconds of this clock."""

    def unix_ns(self) -> int:
        """Unix time, for the log."""


def chosen_clock(
    speed: float,
    file: Path | None,
    follower: Follower,
    stopped: Callable[[], bool] = lambda: False,
    *,
    lockstep: bool = False,
) -> Clock:
    """Clock of a process by its options.

    ``speed``: of stack time against the wall's; ``file``: of a simulator's clock; None: the wall's;
    ``follower``: who this is; ``stopped``: whether the process is to end; ``lockstep``: the simulator counts
    the ticks.
    Raises ValueError: options that exclude each other, or a file that is no clock; OSError: there is no such
    file.
    """
    given = {"--speed": speed != 1.0, "--clock": file is not None, "--lockstep": lockstep}
    names = [name for name, is_given in given.items() if is_given]
    if len(names) > 1:
        raise ValueError(f"{' and '.join(names)} exclude each other: each sets the time; give one of them")
    return FollowedClock(file, follower, stopped) if file is not None else FastClock(speed)
