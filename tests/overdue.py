"""Ends what hangs after a failure, and tells what a whole run that takes too long waits for.

A worker that hangs says nothing, and a run that is ended from outside tells only what has passed.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import subprocess
import sys
import threading

import pytest
from _pytest.faulthandler import fault_handler_stderr_fd_key, get_timeout_config_value

AFTER_S = 1500.0  # s; a whole run takes ten minutes
_under_way: set[str] = set()
_TIMER = pytest.StashKey[threading.Timer]()


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Bound what follows a failure, such as the ends of fixtures: pytest's own time-outs stop with it.

    The worker ends, with the stacks of all threads, and another one goes on.
    """
    within_s = get_timeout_config_value(node.config)
    stderr = node.config.stash.get(fault_handler_stderr_fd_key, None)
    if within_s > 0.0 and stderr is not None:
        faulthandler.dump_traceback_later(within_s, file=stderr, exit=True)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Begin to wait, in the process that hears of all tests."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        timer = session.config.stash[_TIMER] = threading.Timer(AFTER_S, tell)
        timer.daemon = True
        timer.start()


def pytest_runtest_logstart(nodeid: str) -> None:
    """A test begins."""
    _under_way.add(nodeid)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """A test has ended."""
    _under_way.discard(nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """All have ended."""
    if (timer := session.config.stash.get(_TIMER, None)) is not None:
        timer.cancel()


def tell() -> None:
    """Print tests and processes."""
    command, listed = ["ps", "-eo", "pid,ppid,stat,wchan:20,etimes,args"], "no ps here"
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        listed = subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=True).stdout
    names = "\n  ".join(sorted(_under_way))
    print(f"after {AFTER_S:.0f} s still under way:\n  {names}\n{listed}", file=sys.__stderr__, flush=True)
