"""Time in the simulator's processes: integer ticks and bounded waiting."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable

from flightstack.common.hangup import Stop
from flightstack.common.pacing import Silence

NS_PER_S = 1_000_000_000
STARTUP_S = 600.0  # s of wall time for the start of the other processes of a run, also on slow computers
_SAID_S = 10.0  # s after which a wait is reported
_PAUSE_S = 50e-6  # s; with the system's timer slack about 0.1 ms


class NoAnswerError(RuntimeError):
    """Another process of the run did not start or stopped answering; the text names it and the time."""


def told(what: str) -> str:
    """Report a wait once; returns the empty text."""
    with contextlib.suppress(OSError):  # no reader
        print(f"waits for {what}", file=sys.stderr, flush=True)
    return ""


class TickGrid:
    """Tick k is at k / rate; in nanoseconds and, for the physics, in whole milliseconds."""

    def __init__(self, rate_hz: int) -> None:
        self.rate_hz = rate_hz
        self.period_s = 1.0 / rate_hz

    def ns(self, tick: int) -> int:
        """Time of a tick, ns, cut to a whole number."""
        return tick * NS_PER_S // self.rate_hz

    def ms(self, tick: int) -> int:
        """Time of a tick, ms, to the nearest: for rates that do not divide 1000 ticks are 1 ms uneven."""
        return (2000 * tick + self.rate_hz) // (2 * self.rate_hz)

    def count(self, duration_s: float | None) -> int | None:
        """Number of ticks in a duration; None for no end."""
        return None if duration_s is None else max(1, round(duration_s * self.rate_hz))


def wait_until(
    done: Callable[[], bool],
    stop: Stop,
    timeout_s: float,
    *,
    pause_s: float = _PAUSE_S,
    yields: int = 0,
    what: str = "",
) -> bool:
    """Poll ``done`` until it is true, ``stop`` is set, or the time is over.

    Zenoh's handlers have no wait with a time limit, so this polls: first without sleeping, for short waits,
    then with short sleeps.

    ``timeout_s``: wall time without pauses of the machine; ``pause_s``: sleep between two polls; ``yields``:
    polls that only yield the processor, before the first sleep; ``what``: text on standard error during a
    long wait; empty: none. Returns False after the time limit; after True ``stop`` has to be checked.
    """
    if done() or stop.is_set:
        return True
    silence = Silence()
    looks = 0
    while (silent_s := silence.look()) < timeout_s:
        looks += 1
        if what and silent_s > _SAID_S:
            what = told(what)
        time.sleep(0.0 if looks <= yields else pause_s)
        if done() or stop.is_set:
            return True
    return False
