"""Child processes by fork, which share the loaded modules of their parent."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO, NoReturn

PR_SET_PDEATHSIG = 1  # linux/prctl.h
_PR_SET_NAME = 15
_NAME_BYTES = 15  # length of a thread's name
_LAST_STREAM = 2  # standard error
_LOOK_MAX_S = 0.05  # s between two checks of a child, as in subprocess


def may_fork() -> bool:
    """Whether a fork is safe: on Linux, without other threads, whose locks the child could not release."""
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1


def end_with(parent: int, name: str) -> None:
    """Name this process (15 bytes, ``ps -e``); the kernel ends it when its parent ``parent`` is killed."""
    if sys.platform != "linux":
        return
    kernel = ctypes.CDLL(None)
    kernel.prctl(_PR_SET_NAME, name.encode()[:_NAME_BYTES])
    kernel.prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    if os.getppid() != parent:  # the parent was killed before
        os._exit(1)


def hand_on_niceness(pid: int) -> None:
    """Apply the niceness of this process to the session of a child, or to its own.

    Linux schedules sessions before processes (sched(7), autogroup), and a new session has niceness 0: without
    this, ``nice`` would have no effect on other programs.
    """
    steps = os.getpriority(os.PRIO_PROCESS, 0)
    if steps > 0:
        with contextlib.suppress(OSError):  # no autogroups; or not root, and a second change within 0.1 s
            Path(f"/proc/{pid}/autogroup").write_text(str(steps))


class Forked:
    """A child process by ``os.fork`` with the methods of ``subprocess.Popen`` that are used here.

    It has a session, signal handlers, standard streams and files of its own, and ends with ``os._exit``
    without exit handlers of the parent.

    ``name``: shown by the system; ``run``: its function, which ends as a Python program does, with SystemExit
    or an exception; ``errors``: file of its standard error.
    """

    def __init__(self, name: str, run: Callable[[], object], errors: IO[bytes]) -> None:
        # exit status; negative: the signal that ended it; None: not known to have ended
        self.returncode: int | None = None
        parent, (output, written) = os.getpid(), os.pipe()
        # until it has its own handlers
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        try:
            self.pid = os.fork()
            if self.pid == 0:
                _go_on(name, run, parent, written, errors.fileno(), blocked)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        os.close(written)
        self.stdout: IO[bytes] | None = os.fdopen(output, "rb")  # its standard output

    def poll(self) -> int | None:
        """Exit status, or None while it runs."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its exit status. Raises subprocess.TimeoutExpired: after ``timeout`` seconds."""
        until_s = None if timeout is None else time.monotonic() + timeout
        look_s = 0.0005
        while (code := self.poll()) is None:
            if until_s is not None and time.monotonic() >= until_s:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(look_s)
            look_s = min(2.0 * look_s, _LOOK_MAX_S)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _go_on(
    name: str, run: Callable[[], object], parent: int, output: int, errors: int, blocked: Iterable[int]
) -> NoReturn:
    """The child's part."""
    code = 1
    try:
        end_with(parent, name)
        leave_parent(output, errors)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        gc.freeze()  # memory shared with the parent is not scanned, and so not copied
        code = _code_of(run)
        for thread in threading.enumerate():
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
    except BaseException:  # no handler of the parent may catch it
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # its reader is gone
            stream.flush()
    os._exit(code)


def leave_parent(output: int, errors: int) -> None:
    """Separate a child from its parent after fork: session, signal handlers, standard streams, files.

    ``output``, ``errors``: file numbers that become standard output and error.
    """
    os.setsid()
    hand_on_niceness(os.getpid())
    forget_handlers()
    _own_streams(output, errors)


def forget_handlers() -> None:
    """Signal handling of a new Python process; signals ignored by the parent remain ignored."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _own_streams(output: int, errors: int) -> None:
    """No input, these two outputs, and no other file of the parent."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    # their numbers may be those of standard streams if the parent had none
    for place, number in enumerate([_above(each) for each in (nothing, output, errors)]):
        os.dup2(number, place)
    for number in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        if number > _LAST_STREAM:
            with contextlib.suppress(OSError):  # the descriptor of the listing itself
                os.close(number)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)


def _above(number: int) -> int:
    """The same file under a number above those of the streams."""
    return fcntl.fcntl(number, fcntl.F_DUPFD, _LAST_STREAM + 1)


def _code_of(run: Callable[[], object]) -> int:
    """Exit status of a Python program that ends by this exception or result."""
    try:
        run()
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        print(ended.code, file=sys.stderr)
        return 1
    return 0
