"""Times of the ticks: absolute deadlines in real time, messages of the simulator in lockstep.

Stack time, in seconds, is the time since the start of the process (monotonic clock) or simulated time. In
lockstep the time in the log is simulated time after a fixed date, so that equal seeds give equal logs.

A simulator that paces itself shares its clock with the processes of its run in a file. The simulator writes
the simulated time; the processes use this time instead of wall time. Each process (follower) writes the time
until which it sleeps. At this time the simulator waits for the process, so a busy machine slows all equally.
The file contains 64-bit integers in nanoseconds: Unix time of the clock's zero, simulated time, and for each
follower the simulated time until which it sleeps.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import mmap
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import NamedTuple

from flightstack.common.hangup import never_wait

EPOCH_NS = 1_577_836_800_000_000_000  # Unix time at zero of simulated clocks, ns: 2020-01-01T00:00:00Z
RUN_AHEAD_TICKS = 20  # maximum number of ticks by which a robot is simulated ahead of its vehicle
NO_GO = -1  # second value of a credit (onboard/lockstep.py) as long as the robot must not drive
# wall time without a message after which the onboard process counts as dead in lockstep, s: on a busy
# computer a running process can wait for the processor for many seconds
COMPANION_SILENT_S = 20.0
_SAID_S = 10.0  # waiting time after which a text reports the wait, s
_LOOK_MAX_S = 0.1  # maximum time between two polls that counts as waiting time, s
# priority under SCHED_FIFO, 1 to 99: above all ordinary processes, below the kernel's threads
PRIORITY = 10
_DAY_NS = 86_400_000_000_000
_LOCK_WHAT_IS_USED = 1 | 2 | 4  # flags MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT of Linux's mlockall(2)
_ZERO, _NOW, _FIRST = 0, 1, 2  # positions of the integers in the clock's file
_ABSENT = -1  # value of a follower that has not started or is ignored
_NS = 1_000_000_000
_ROUNDING_NS = 1_000  # margin, ns: larger than the rounding of a time in seconds, smaller than any step
_YIELDS = 20  # number of polls without a sleep
_PAUSE_S = 50e-6  # time between two polls, s; the system's timer slack extends this time to 0.1 ms
_FOLLOWER_MAX_S = 0.5  # maximum wall time of a wait for a follower, which may have been killed, s
_STALL_MAX_S = 2.5  # wall time without a step after which followers use wall time, s


@dataclass(frozen=True, slots=True)
class FastClock:
    """Wall clock that runs ``speed`` times as fast as real time, for simulators with that speed.

    At the last midnight (UTC) ``unix_ns`` equals the true time, so all processes of a run agree on it.
    """

    speed: float = 1.0

    def monotonic(self) -> float:
        return time.monotonic() * self.speed

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds / self.speed)

    def unix_ns(self) -> int:
        """Return the Unix time; it is ahead of the true time unless ``speed`` is 1."""
        now_ns = time.time_ns()
        ahead = self.speed - 1.0
        return now_ns + round(ahead * (now_ns % _DAY_NS)) if ahead else now_ns


class Tick(NamedTuple):
    """Number and time of one controller tick, and the lateness of its start."""

    number: int
    now_s: float  # time on the stack's clock, s
    unix_ns: int  # time on the system clock, ns since 1970
    period_s: float  # time since the previous tick (in lockstep: wall time), s; 0 for the first tick
    lateness_s: float  # delay between the tick's deadline and its start, s; 0 in lockstep
    overruns: int = 0  # number of missed deadlines so far


def wait_until(
    done: Callable[[], bool],
    stopped: Callable[[], bool],
    timeout_s: float,
    *,
    pause_s: float = _PAUSE_S,
    what: str = "",
) -> bool:
    """Poll ``done`` and ``stopped`` until one of them is true or the time-out has passed.

    Zenoh's handlers cannot wait with a time-out. The first polls only yield the processor, because a message
    usually arrives during these polls.

    ``timeout_s``: maximum wall time; a pause of the machine counts as at most 0.1 s; ``pause_s``: sleep
    between two polls; ``what``: text on standard error during a long wait, if not empty. Returns False after
    the time-out; after True, the caller must check ``stopped``.
    """
    if done() or stopped():
        return True
    waited_s, looks, looked_s = 0.0, 0, time.monotonic()
    while waited_s < timeout_s:
        looks += 1
        if what and waited_s > _SAID_S:
            with contextlib.suppress(OSError):  # standard error may be closed
                print(f"waits for {what}", file=sys.stderr, flush=True)
            what = ""
        time.sleep(0.0 if looks <= _YIELDS else pause_s)
        if done() or stopped():
            return True
        now_s = time.monotonic()
        waited_s += min(now_s - looked_s, _LOOK_MAX_S)
        looked_s = now_s
    return False


class RealTimePacer:
    """Clock of ticks with absolute deadlines at a fixed rate; a missed deadline is counted and skipped."""

    def __init__(self, rate_hz: int, clock: Clock) -> None:
        self.period_s = 1.0 / rate_hz
        self.overruns = 0  # number of missed deadlines so far
        self._clock = clock
        self._start_s = clock.monotonic()
        self.unix_start_ns = clock.unix_ns()  # Unix time at zero of the stack's clock, ns
        self._next = 0  # number of the next deadline
        self._ticks = 0
        self._last_s: float | None = None

    def now_s(self) -> float:
        """Return the time on the stack clock, s."""
        return self._clock.monotonic() - self._start_s

    def wait(self) -> Tick:
        """Sleep until the next deadline; return its tick."""
        clock, deadline_s = self._clock, self._start_s + self._next * self.period_s
        while (ahead_s := deadline_s - clock.monotonic()) > 0.0:
            clock.sleep(ahead_s)
        began_s = clock.monotonic()
        late_s = began_s - deadline_s
        missed = int(late_s / self.period_s)
        self.overruns += missed
        self._next += 1 + missed
        period_s = began_s - self._last_s if self._last_s is not None else 0.0
        self._last_s = began_s
        now_s = began_s - self._start_s
        unix_ns = self.unix_start_ns + round(now_s * 1e9)
        tick = Tick(self._ticks, now_s, unix_ns, period_s, late_s, self.overruns)
        self._ticks += 1
        return tick


class Follower(IntEnum):
    """Processes that follow the clock; the values give the order of the processes' integers in the file."""

    ONBOARD = 0
    TARGET = 1


_SIZE = 8 * (_FIRST + len(Follower))


def _opened(path: Path) -> memoryview:
    with path.open("r+b") as file:
        return memoryview(mmap.mmap(file.fileno(), _SIZE)).cast("q")


class SimulationClock:
    """The clock in the simulator: it creates the file, writes the time and waits for the followers."""

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
        """Set the simulated time; wait until ``stopped()`` holds or each follower sleeps until a later time.

        A follower that needs more than 0.5 s of wall time is ignored until it writes its next time.
        """
        cells, until_s = self._cells, time.monotonic() + _FOLLOWER_MAX_S
        cells[_NOW] = now_ns
        while not stopped():
            behind = [f for f in Follower if _ABSENT < cells[_FIRST + f] <= now_ns]
            if not behind:
                return
            if time.monotonic() > until_s:
                for follower in behind:
                    cells[_FIRST + follower] = _ABSENT
                return
            time.sleep(_PAUSE_S)


class FollowedClock:
    """The clock in a follower.

    After 2.5 s without a step the simulator counts as stopped. Time then passes as wall time, so that
    time-outs of the follower still end. The same applies while ``stopped()`` is true: the process then ends.
    """

    def __init__(self, path: Path, follower: Follower, stopped: Callable[[], bool] = lambda: False) -> None:
        size = path.stat().st_size
        if size != _SIZE:
            raise ValueError(f"{path} is not a simulator's clock: it has {size} bytes, a clock has {_SIZE}")
        self._cells, self._place, self._stopped = _opened(path), _FIRST + follower, stopped
        self._seen_ns, self._moved_s = self._cells[_NOW], time.monotonic()
        self._ahead_s = 0.0  # total time that passed during past stalls of the simulator, s
        self._stall_s = 0.0  # time that has passed during the current stall of the simulator, s
        self._least_s = 0.0  # minimum time that the clock returns, s: the end of the last sleep

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
        """Sleep for this number of simulated seconds."""
        until_s = self.monotonic() + seconds
        # the simulator stops at until_ns until this follower continues; the margin makes a rounded time count
        until_ns = int((until_s - self._ahead_s - self._stall_s) * _NS) - _ROUNDING_NS
        self._cells[self._place] = until_ns
        while self._cells[_NOW] < until_ns and self.monotonic() < until_s:
            time.sleep(_PAUSE_S)
        self._least_s = until_s

    def unix_ns(self) -> int:
        """Return the Unix time of the run, which is equal in all its processes."""
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
    """Return the clock that ``--speed``, ``--clock`` and ``--lockstep`` of a process select."""
    given = {"--speed": speed != 1.0, "--clock": file is not None, "--lockstep": lockstep}
    names = [name for name, is_given in given.items() if is_given]
    if len(names) > 1:
        raise ValueError(f"{' and '.join(names)} exclude each other: each sets the time; give one of them")
    return FollowedClock(file, follower, stopped) if file is not None else FastClock(speed)


def ask_for_priority() -> bool:
    """Request real-time priority; return False if it is not allowed or not available.

    With ordinary scheduling another process can keep the core for some milliseconds (3 to 4 on Linux), which
    delays ticks. The request needs CAP_SYS_NICE or an rtprio limit.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


def give_up_priority() -> None:
    """Restore ordinary priority, because an overloaded process must not block a core."""
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def keep_memory() -> bool:
    """Lock the memory of this process; return False if that is not allowed or not available.

    A system with little free memory evicts pages of programs: a tick then waits for the disk (0.8 s
    measured). Locking needs root or an unlimited memlock limit; with another limit, allocations could fail.
    """
    try:
        unlimited = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
        lock = ctypes.CDLL(None).mlockall
    except (AttributeError, OSError):
        return False
    return (unlimited or os.geteuid() == 0) and lock(_LOCK_WHAT_IS_USED) == 0


def run_promptly() -> None:
    """Request priority and locked memory, if the system allows them; from now on never wait for output."""
    never_wait()
    ask_for_priority()
    keep_memory()


def quiet_garbage_collector() -> None:
    """Prevent garbage collection in the loop: freeze existing objects; the loop makes no reference cycles."""
    gc.collect()
    gc.freeze()
    gc.disable()
