"""Flights in real time on a machine that pauses: an attempt in which it did shows nothing, and is repeated.

A virtual machine whose host gives its processors to others stands still for tenths of a second; then states
are too old, and the stack rightly gives up. A thread on each processor measures how late it wakes. A failure
without such a pause counts at once, and so does the second attempt that hung until its time was over. A test
that failed with a pause in each attempt is skipped, with the pauses as the reason: that machine can not fly
in real time. The attempts for nothing have a bound over all tests of a worker; beyond it a test that failed
with a pause is skipped at once.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Sequence

import pytest
from _pytest.runner import runtestprotocol

from flightstack.common.forked import hand_on_niceness
from flightstack.common.pacing import keep_memory

ATTEMPTS = 6
PAUSE_S = 0.1  # half of the age at which an own state is no longer flown by (checks.own_age_max_s)
CALM_S = 2.0  # s without a pause, waited for before another attempt
CALM_WAIT_MAX_S = 30.0  # s
REPEATS_MAX_S = 150.0  # s of wall time for all attempts for nothing of a worker, and for calm after them
GIVES_WAY = 15  # niceness of a worker, and of what it starts, from its first test that is not in real time on
HANGS_S = 240.0  # s, below pytest's time-out; an attempt that takes so long hangs, twice is a failure
_SLEEP_S = 0.01
_SPENT_S = pytest.StashKey[float]()  # of that bound
_FOR_NOTHING = pytest.StashKey[list[tuple[float, float]]]()  # longest pause and time of such attempts, s


class Pauses:
    """Longest pause of a processor while the context is open.

    Attributes:
        worst_s: by which a thread woke too late, at most.
        last_s: end of the newest pause, of the monotonic clock.
    """

    def __init__(self) -> None:
        self.worst_s, self.last_s = 0.0, time.monotonic()
        self._over = threading.Event()
        places = sorted(os.sched_getaffinity(0))
        self._threads = [threading.Thread(target=self._watch, args=(p,), daemon=True) for p in places]

    def __enter__(self) -> Pauses:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()

    def _watch(self, place: int) -> None:
        os.sched_setaffinity(threading.get_native_id(), {place})
        last_s = time.monotonic()
        while not self._over.wait(_SLEEP_S):
            now_s = time.monotonic()
            late_s = now_s - last_s - _SLEEP_S
            self.worst_s = max(self.worst_s, late_s)
            if late_s >= PAUSE_S:
                self.last_s = now_s
            last_s = now_s


def in_real_time(item: pytest.Item) -> bool:
    """Whether a test flies in real time."""
    return any("real-time" in mark.args for mark in item.iter_markers("xdist_group"))


def await_calm(within_s: float) -> None:
    """Return when the machine has not paused for a while, or after a limit."""
    until_s = time.monotonic() + within_s
    with Pauses() as pauses:
        while (now_s := time.monotonic()) < until_s and now_s - pauses.last_s < CALM_S:
            time.sleep(_SLEEP_S)


def skipped(item: pytest.Item, reports: Sequence[pytest.TestReport], worst_s: Sequence[float]) -> None:
    """Make failures into skips with the pauses as the reason."""
    told = ", ".join(f"{s:.2f}" for s in worst_s)
    reason = f"Skipped: not a machine for real time, it paused for {told} s in {len(worst_s)} attempts"
    for report in reports:
        if report.failed:
            report.outcome = "skipped"
            report.longrepr = (str(item.path), item.location[1] or 0, reason)


def _again(item: pytest.Item) -> bool:
    """Whether a test is tried again after an attempt for nothing, once the machine is calm."""
    took_s = [each for _, each in item.stash[_FOR_NOTHING]]
    if took_s[-1] >= HANGS_S:
        return sum(each >= HANGS_S for each in took_s) == 1
    spent_s = item.config.stash[_SPENT_S] = item.config.stash.get(_SPENT_S, 0.0) + took_s[-1]
    if len(took_s) >= ATTEMPTS or spent_s >= REPEATS_MAX_S:
        return False
    began_s = time.monotonic()
    await_calm(min(CALM_WAIT_MAX_S, REPEATS_MAX_S - spent_s))
    item.config.stash[_SPENT_S] = spent_s + time.monotonic() - began_s
    return True


def _give_way() -> None:
    """Be nice as a session of its own: Linux looks at that of sessions first (sched(7), autogroup).

    In the session of the workers that fly, ordinary threads of these waited up to 0.15 s for a nice one.
    """
    os.setpriority(os.PRIO_PROCESS, 0, GIVES_WAY)
    with contextlib.suppress(OSError):  # it leads one already
        os.setsid()
    hand_on_niceness(os.getpid())


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test in real time again while it fails on a machine that paused; others give way to it."""
    if not in_real_time(item):
        if "PYTEST_XDIST_WORKER" in os.environ and os.getpriority(os.PRIO_PROCESS, 0) < GIVES_WAY:
            _give_way()
        return None
    keep_memory()  # relays of the tests are part of the flight
    where = {"nodeid": item.nodeid, "location": item.location}
    for_nothing = item.stash.setdefault(_FOR_NOTHING, [])
    if not for_nothing:
        item.ihook.pytest_runtest_logstart(**where)
    with Pauses() as pauses:
        began_s = time.monotonic()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        took_s = time.monotonic() - began_s
    if pauses.worst_s >= PAUSE_S and any(report.failed for report in reports):
        for_nothing.append((pauses.worst_s, took_s))
        told = f"attempt {len(for_nothing)} failed, the machine paused for {pauses.worst_s:.2f} s"
        print(f"{item.nodeid}: {told}")
        if _again(item):
            item._initrequest()  # fixtures of the test are made anew
            # by its hook, as the failure has ended the time-outs of pytest, and each attempt needs its own
            return item.ihook.pytest_runtest_protocol(item=item, nextitem=nextitem)
        if took_s < HANGS_S:
            skipped(item, reports, [worst_s for worst_s, _ in for_nothing])
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(**where)
    return True
