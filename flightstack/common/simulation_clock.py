"""Clock of a simulator that paces itself; a file shares it with the processes of its run.

The simulator writes its time, which the other processes use instead of wall time. Each of them writes the
time until which it sleeps, and the simulator waits for it there: a busy machine slows all processes equally.
The file contains 64-bit integers in nanoseconds: Unix time of the clock's zero, simulated time, and for each
follower the simulated time until which it sleeps.
"""

from __future__ import annotations

import mmap
import time
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

from flightstack.common.pacing import FastClock

_ZERO, _NOW, _FIRST = 0, 1, 2  # positions in the file
_ABSENT = -1  # value of a follower that has not started, or was given up
_NS = 1_000_000_000
_ROUNDING_NS = 1_000  # larger than the rounding of seconds as float, smaller than any step
_PAUSE_S = 50e-6  # time between two polls, s; about 0.1 ms with the timer slack of the system
_FOLLOWER_MAX_S = 0.5  # longest wait for a follower, which may have been killed, s of wall time
_STALL_MAX_S = 2.5  # wall time without a step after which followers use wall time, s


class Follower(IntEnum):
    """Processes that follow the clock, with their positions in the file."""

    ONBOARD = 0
    TARGET = 1


_SIZE = 8 * (_FIRST + len(Follower))


def _opened(path: Path) -> memoryview:
    with path.open("r+b") as file:
        return memoryview(mmap.mmap(file.fileno(), _SIZE)).cast("q")


class SimulationClock:
    """The simulator's side of the clock: it creates the file, writes the time and waits for followers."""

    def __init__(self, path: Path) -> None:
        path.write_bytes(bytes(_SIZE))
        self._cells = _opened(path)
        self._cells[_ZERO] = time.time_ns()
        for follower in Follower:
            self._cells[_FIRST + follower] = _ABSENT

    def unix_ns(self) -> int:
        """Return the Unix time of the run: that of the clock's zero plus the simulated time."""
        return self._cells[_ZERO] + self._cells[_NOW]

    def advance(self, now_ns: int, stopped: Callable[[], bool]) -> None:
        """Set the simulated time, then wait until no follower is due; ``stopped`` ends the wait.

        A follower that needs more than half a second of wall time is ignored until it returns.
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
    """A follower's side of the clock.

    After 2.5 s without a step the simulator counts as stopped. Time then passes as wall time, so that
    time-outs of the follower still end. The same applies if ``stopped`` says that this process ends. Raises
    OSError: there is no such file; ValueError: the file is no clock.
    """

    def __init__(self, path: Path, follower: Follower, stopped: Callable[[], bool] = lambda: False) -> None:
        size = path.stat().st_size
        if size != _SIZE:
            raise ValueError(f"{path} is not a simulator's clock: it has {size} bytes, a clock has {_SIZE}")
        self._cells, self._place, self._stopped = _opened(path), _FIRST + follower, stopped
        self._seen_ns, self._moved_s = self._cells[_NOW], time.monotonic()
        self._ahead_s = 0.0  # lead over simulated time by past stalls
        self._stall_s = 0.0  # lead over simulated time by the current stall
        self._least_s = 0.0  # end of the last sleep

    def monotonic(self) -> float:
        """Return the simulated time, s."""
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
        """Sleep for a number of simulated seconds."""
        until_s = self.monotonic() + seconds
        # The simulator waits at this time, so it counts as reached despite rounding.
        until_ns = int((until_s - self._ahead_s - self._stall_s) * _NS) - _ROUNDING_NS
        self._cells[self._place] = until_ns
        while self._cells[_NOW] < until_ns and self.monotonic() < until_s:
            time.sleep(_PAUSE_S)
        self._least_s = until_s

    def unix_ns(self) -> int:
        """Return the Unix time of the run, which is the same for all its processes."""
        return self._cells[_ZERO] + round(self.monotonic() * _NS)


Clock = FastClock | FollowedClock  # clock that paces a process in real time


def chosen_clock(
    speed: float,
    file: Path | None,
    follower: Follower,
    stopped: Callable[[], bool] = lambda: False,
    *,
    lockstep: bool = False,
) -> Clock:
    """Return the clock that the options of a process select.

    ``speed``: stack time over wall time; ``file``: file of a simulator's clock, None for wall time;
    ``lockstep``: whether the simulator sends the ticks.
    Raises ValueError: options exclude each other, or the file is invalid; OSError: there is no such file.
    """
    given = {"--speed": speed != 1.0, "--clock": file is not None, "--lockstep": lockstep}
    names = [name for name, is_given in given.items() if is_given]
    if len(names) > 1:
        raise ValueError(f"{' and '.join(names)} exclude each other: each sets the time; give one of them")
    return FollowedClock(file, follower, stopped) if file is not None else FastClock(speed)
