"""Simulated time as integer ticks, and waiting with a time-out, for the simulator's processes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack

from flightstack.common.hangup import Stop
from flightstack.common.pacing import wait_until

NS_PER_S = 1_000_000_000
STARTUP_S = 600.0  # time-out for the start of the other processes, s of wall time; long for slow computers
_MATCH_PAUSE_S = 0.002  # time between two checks for subscribers, s


class NoAnswerError(RuntimeError):
    """Another process did not start or no longer answers; the text names the process and the time waited."""


def run_process(verb: str, work: Callable[[Stop, ExitStack], None]) -> int:
    """Run ``work`` as a process of the simulator; print errors after the command's name ``verb``.

    Returns the exit status: 0 after an orderly end, 1 after a time-out, 2 for bad input.
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

        If the rate does not divide 1000, the periods differ by 1 ms.
        """
        return (2000 * tick + self.rate_hz) // (2 * self.rate_hz)

    def count(self, duration_s: float | None) -> int | None:
        """Return the number of ticks in a duration; None: the duration is unlimited."""
        return None if duration_s is None else max(1, round(duration_s * self.rate_hz))


def await_subscriber(matched: Callable[[], bool], key: str, stop: Stop) -> None:
    """Wait until an onboard process has subscribed to a key; messages without a subscriber are lost.

    Raises NoAnswerError: time-out.
    """
    what = f"a subscriber to {key}"
    if not wait_until(matched, lambda: stop.is_set, STARTUP_S, pause_s=_MATCH_PAUSE_S, what=what):
        raise NoAnswerError(
            f"nobody subscribed to {key} within {STARTUP_S:g} s; does the onboard process run in lockstep, "
            "with [fleet] in a team, and is it connected to this process's endpoint?"
        )
