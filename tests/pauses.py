"""Flights in real time on a machine that pauses: an attempt in which it did shows nothing, and is repeated.

A virtual machine whose host gives its processors to others stands still for tenths of a second; then states
are too old, and the stack rightly gives up. A thread measures how late it wakes. A failure without such a
pause counts at once.
"""

from __future__ import annotations

import threading
import time

import pytest
from _pytest.runner import runtestprotocol

ATTEMPTS = 4
PAUSE_S = 0.1  # half of the age at which an own state is no longer flown by (checks.own_age_max_s)
_SLEEP_S = 0.01


class Pauses:
    """Longest pause of this process while the context is open.

    Attributes:
        worst_s: by which it woke too late, at most.
    """

    def __init__(self) -> None:
        self.worst_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Pauses:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        last_s = time.monotonic()
        while not self._over.wait(_SLEEP_S):
            now_s = time.monotonic()
            self.worst_s = max(self.worst_s, now_s - last_s - _SLEEP_S)
            last_s = now_s


def in_real_time(item: pytest.Item) -> bool:
    """Whether a test flies in real time."""
    return any("real-time" in mark.args for mark in item.iter_markers("xdist_group"))


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test in real time again while it fails on a machine that paused."""
    if not in_real_time(item):
        return None
    where = {"nodeid": item.nodeid, "location": item.location}
    item.ihook.pytest_runtest_logstart(**where)
    for attempt in range(1, ATTEMPTS + 1):
        with Pauses() as pauses:
            reports = runtestprotocol(item, log=False, nextitem=nextitem)
        if not any(report.failed for report in reports) or pauses.worst_s < PAUSE_S:
            break
        print(f"{item.nodeid}: failed, and the machine paused for {pauses.worst_s:.2f} s: attempt {attempt}")
        if attempt < ATTEMPTS:
            item._initrequest()  # fixtures of the test are made anew
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(**where)
    return True
