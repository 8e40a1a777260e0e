"""Simulated time as integer ticks, and waiting with a time-out, for the simulator's processes."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack

from flightstack.common.hangup import Stop
from flightstack.common.pacing import Silence

NS_PER_S = 1_000_000_000
STARTUP_S = 600.0  # time-out of the start of a run's other processes, wall time, s; long for slow computers
_SAID_S = 10.0  # waiting time after which a text reports the wait, s
_PAUSE_S = 50e-6  # sleep between two polls, s; with the system's timer slack about 0.1 ms


class NoAnswerError(RuntimeError):
    """Another process of the run did not start or no longer answers; the message names it and the wait."""


def run_process(verb: str, work: Callable[[Stop, ExitStack], None]) -> int:
    """Run ``work`` as a process of the simulator; print errors after the command's name ``verb``.

    Returns the exit status: 0 if ended in order, 1 after a time-out, 2 for bad input.
    """
    stop = Stop()
    try:
        with ExitStack() as stack:
            work(stop, stack)
    except ValueError as error:
        print(f"{verb}: {error}", file=sys.stderr)
        return 2
    except (OSError, NoAnswerError) as error:
        print(f"{verb}: {error}", file=sys.stderr)
        return 1
    return 0


class TickGrid:
    """Time of each tick, in ns and, for the physics, in whole ms: tick k is at k / rate."""

    def __init__(self, rate_hz: int) -> None:
        self.rate_hz = rate_hz
        self.period_s = 1.0 / rate_hz

    def ns(self, tick: int) -> int:
        """Return the time of a tick, ns, rounded down."""
        return tick * NS_PER_S // self.rate_hz

    def ms(self, tick: int) -> int:
        """Return the time of a tick in whole ms, rounded.

        Ticks are uneven by 1 ms if the rate does not divide 1000.
        """
        return (2000 * tick + self.rate_hz) // (2 * self.rate_hz)

    def count(self, duration_s: float | None) -> int | None:
        """Return the number of ticks in a duration; None: the duration is unlimited."""
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
    """Poll ``done`` until it is true, ``stop`` is set, or the time-out has passed.

    Zenoh's handlers cannot wait with a time-out. This function polls, first without, then with short sleeps.

    ``timeout_s``: wall time, not counting suspension of the machine; ``pause_s``: sleep between
    two polls; ``yields``: number of polls that only yield the processor, before the first sleep; ``what``:
    text on standard error during a long wait, if not empty. Returns False after the time-out; after True,
    check ``stop``.
    """
    if done() or stop.is_set:
        return True
    silence = Silence()
    looks = 0
    while (silent_s := silence.look()) < timeout_s:
        looks += 1
        if what and silent_s > _SAID_S:
            with contextlib.suppress(OSError):  # standard error may be closed
                print(f"waits for {what}", file=sys.stderr, flush=True)
            what = ""
        time.sleep(0.0 if looks <= yields else pause_s)
        if done() or stop.is_set:
            return True
    return False
