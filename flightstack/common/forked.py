"""Child processes by fork, which share the modules that their parent has loaded."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from multiprocessing import process
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import IO

PR_SET_PDEATHSIG = 1  # linux/prctl.h
_PR_SET_NAME = 15
_NAME_BYTES = 15  # maximum length of a thread name that Linux stores, bytes
_LAST_STREAM = 2  # file descriptor of standard error


def may_fork() -> bool:
    """Whether a fork is safe: only on Linux and without other threads; a child cannot release their locks."""
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1


def hand_on_niceness(pid: int) -> None:
    """Apply the niceness of this process to the session of a child, or to its own session.

    Linux schedules sessions before processes (sched(7), autogroup), and a new session has niceness 0: without
    this, ``nice`` would have no effect on other programs.
    """
    steps = os.getpriority(os.PRIO_PROCESS, 0)
    if steps > 0:
        with contextlib.suppress(OSError):  # no autogroups, or a second change within 0.1 s without root
            Path(f"/proc/{pid}/autogroup").write_text(str(steps))


class Forked(ForkProcess):
    """Forked process with those methods of ``subprocess.Popen`` that this package uses.

    The process has its own session, signal handlers, standard streams and files.

    ``name``: name that the system shows; ``run``: function of the process, which ends like a Python program,
    with SystemExit or an exception; ``errors``: file for its standard error.
    """

    def __init__(self, name: str, run: Callable[[], object], errors: IO[bytes]) -> None:
        super().__init__(target=run, name=name)
        output, self._output = os.pipe()
        self._errors = errors.fileno()
        # signals are blocked until the child has its own handlers
        self._blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            self.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, self._blocked)
        os.close(self._output)
        # the owner ends the child in bounded time; multiprocessing would wait for it at exit without a limit
        process._children.discard(self)  # type: ignore[attr-defined]
        self.stdout: IO[bytes] | None = os.fdopen(output, "rb")  # standard output of the child

    def run(self) -> None:
        """Run the function in the child; the kernel ends the child if its parent is killed."""
        kernel = ctypes.CDLL(None)
        kernel.prctl(_PR_SET_NAME, self.name.encode()[:_NAME_BYTES])  # the name that ``ps -e`` shows
        kernel.prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
        if os.getppid() != self._parent_pid:  # type: ignore[attr-defined]  # the parent was already killed
            os._exit(1)
        leave_parent(self._output, self._errors)
        signal.pthread_sigmask(signal.SIG_SETMASK, self._blocked)
        gc.freeze()  # the collector does not scan shared memory, so it is not copied
        super().run()

    @property
    def returncode(self) -> int | None:
        """Exit status; negative: number of the signal that ended the process; None: it still runs."""
        return self.exitcode

    def poll(self) -> int | None:
        return self.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the exit status. Raises subprocess.TimeoutExpired: after ``timeout`` seconds."""
        if self.exitcode is None and self.pid is not None:  # ``join`` cannot wait: its pipe is closed
            end = os.pidfd_open(self.pid)
            select.select((end,), (), (), timeout)
            os.close(end)
        if (code := self.exitcode) is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        if self.exitcode is None and self.pid is not None:
            os.kill(self.pid, number)


def leave_parent(output: int, errors: int) -> None:
    """Separate a forked child from its parent: new session, signal handlers, standard streams, files.

    ``output``, ``errors``: descriptors that become standard output and error.
    """
    os.setsid()
    hand_on_niceness(os.getpid())
    forget_handlers()
    _own_streams(output, errors)


def forget_handlers() -> None:
    """Set the signal handling of a new Python process; signals that the parent ignores remain ignored."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _own_streams(output: int, errors: int) -> None:
    """Give the child an empty standard input and these outputs, and close all other files of its parent."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    # if the parent had no standard streams, these descriptors may have their numbers
    for place, number in enumerate([_above(each) for each in (nothing, output, errors)]):
        os.dup2(number, place)
    for number in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        if number > _LAST_STREAM:
            with contextlib.suppress(OSError):  # the descriptor of the directory listing is already closed
                os.close(number)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)


def _above(number: int) -> int:
    """Duplicate a descriptor to a number above 2, the last standard stream; return this number."""
    return fcntl.fcntl(number, fcntl.F_DUPFD, _LAST_STREAM + 1)
