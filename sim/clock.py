"""Time in the simulator's processes: integer ticks and bounded waiting."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable

from flightstack.common.hangup import Stop
from flightstack.common.pacing import Silence

NS_PER_S = 1_000_000_000
STARTUP_S = 600.0  # s of wall time the processes of a run give each other to come up, slow computers, too
_SAID_S = 10.0  # s after which a wait says what it waits for
_PAUSE_S = 50e-6  # s; with the system's timer slack about 0.1 ms


class NoAnswerError(RuntimeError):
    """Another process of the run did not start or stopped answering; the text names it and the time."""


def told(what: str) -> str:
    """Say what is waited for, once; the empty text that is left to say."""
    with contextlib.suppress(OSError):  # nobody reads it
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
    """Look again and again until it is so, a signal came, or the time is over.

    Zenoh's handlers cannot be waited on with a time limit, so this polls: first without sleeping, for what
    is due any moment, then with short sleeps.

    Args:
        done: what is waited for.
        stop: ends the wait.
        timeout_s: wall time; a pause of the machine is not counted.
        pause_s: sleep between two looks.
        yields: looks that only give up the processor, before the first sleep.
        what: said to standard error if it takes long; empty: nothing is said.

    Returns:
        False only when the time is over; look at ``stop`` after True.
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
