"""Repeats a test in real time that failed while the machine paused.

A virtual machine stops for tenths of a second if its host gives the processors to other machines. Then states
become too old, and the stack aborts, as required. A thread on each processor measures the delay of its own
wake-ups. A failure without such a pause is not repeated. Other tests have a lower priority.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time

import pytest

from flightstack.common.pacing import keep_memory
from flightstack.common.processes import hand_on_niceness

REPEATS = 4
PAUSE_S = 0.1  # a longer delay is a pause, s: half of the age limit of a vehicle state (checks.own_age_max_s)
CALM_S = 2.0  # time between two attempts of a test, s
GIVES_WAY = 15  # niceness of a worker and its children from the first test that is not in real time
_SLEEP_S = 0.01


class Pauses:
    """Measures ``worst_s``: longest delay, since ``begin``, with which a thread of any processor woke."""

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._started = False

    def begin(self) -> None:
        self.worst_s = 0.0
        if not self._started:
            self._started = True
            for place in os.sched_getaffinity(0):
                threading.Thread(target=self._watch, args=(place,), daemon=True).start()

    def _watch(self, place: int) -> None:
        os.sched_setaffinity(threading.get_native_id(), {place})
        last_s = time.monotonic()
        while True:
            time.sleep(_SLEEP_S)
            now_s = time.monotonic()
            self.worst_s = max(self.worst_s, now_s - last_s - _SLEEP_S)
            last_s = now_s


PAUSES = Pauses()


def in_real_time(item: pytest.Item) -> bool:
    return any("real-time" in mark.args for mark in item.iter_markers("xdist_group"))


def repeated_after_a_pause() -> pytest.MarkDecorator:
    """Return pytest-rerunfailures' mark that repeats a failed test only if the machine paused during it."""

    def paused(_: BaseException | None) -> bool:
        return PAUSES.worst_s >= PAUSE_S

    return pytest.mark.flaky(reruns=REPEATS, reruns_delay=CALM_S, condition=paused)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Start to measure pauses before a test in real time; lower the priority before other tests."""
    if in_real_time(item):
        keep_memory()  # serial relays run in this process and must not wait for evicted memory pages
        PAUSES.begin()
    elif "PYTEST_XDIST_WORKER" in os.environ and os.getpriority(os.PRIO_PROCESS, 0) < GIVES_WAY:
        # in a new session, because Linux compares the niceness of sessions first (sched(7), autogroup)
        os.setpriority(os.PRIO_PROCESS, 0, GIVES_WAY)
        with contextlib.suppress(OSError):  # the process may already lead a session
            os.setsid()
        hand_on_niceness(os.getpid())
