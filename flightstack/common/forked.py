"""Child processes made by fork: they use the modules that their parent has loaded."""

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
_NAME_BYTES = 15  # of a thread's name
_LAST_STREAM = 2  # standard error
_LOOK_MAX_S = 0.05  # s between two looks whether a child has ended, as subprocess has


def may_fork() -> bool:
    """Whether a child may go on from here: on Linux, and where no other thread runs.

    What another thread has locked, Zenoh's for example, would stay locked in the child.
    """
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1


def end_with(parent: int, name: str) -> None:
    """Have the kernel end this process when its parent is killed, and show it under this name (``ps -e``).

    ``parent``: process id of the one that started this one; ``name``: of the process; 15 bytes are shown.
    """
    if sys.platform != "linux":
        return
    kernel = ctypes.CDLL(None)
    kernel.prctl(_PR_SET_NAME, name.encode()[:_NAME_BYTES])
    kernel.prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    if os.getppid() != parent:  # it was killed before
        os._exit(1)


def hand_on_niceness(pid: int) -> None:
    """Give the niceness of this process to the session of a child, or to its own.

    Linux shares processors among sessions before it looks at niceness (sched(7), autogroup), and a session
    begins with none: what is started with ``nice`` would take as much from others as without.
    """
    steps = os.getpriority(os.PRIO_PROCESS, 0)
    if steps > 0:
        with contextlib.suppress(OSError):  # no such groups; or not root, and asked twice within 0.1 s
            Path(f"/proc/{pid}/autogroup").write_text(str(steps))


class Forked:
    """A child process made by ``os.fork``; it has those methods of ``subprocess.Popen`` that are used here.

    It has a session, signal handlers, standard streams and files of its own; it ends with ``os._exit``, so
    that nothing runs that this process has registered for its end.

    ``name``: under which the system shows it; ``run``: what it does; ends as a Python program does, with
    SystemExit or an exception; ``errors``: file for what it writes to standard error.
    """

    def __init__(self, name: str, run: Callable[[], object], errors: IO[bytes]) -> None:
        # its exit status, negative: the signal that ended it; None: it runs, as far as is known
        self.returncode: int | None = None
        parent, (output, written) = os.getpid(), os.pipe()
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # until it has its own
        try:
            self.pid = os.fork()  # its process id
            if self.pid == 0:
                _go_on(name, run, parent, written, errors.fileno(), blocked)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        os.close(written)
        self.stdout: IO[bytes] | None = os.fdopen(output, "rb")  # what it writes to standard output

    def poll(self) -> int | None:
        """Exit status if it has ended, else None."""
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; its exit status.

        Raises subprocess.TimeoutExpired: it runs longer than so many seconds.
        """
        until_s = None if timeout is None else time.monotonic() + timeout
        look_s = 0.0005
        while (code := self.poll()) is None:
            if until_s is not None and time.monotonic() >= until_s:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(look_s)
            look_s = min(2.0 * look_s, _LOOK_MAX_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self.send_signal(signal.SIGKILL)


def _go_on(
    name: str, run: Callable[[], object], parent: int, output: int, errors: int, blocked: Iterable[int]
) -> NoReturn:
    """Be the child."""
    code = 1
    try:
        end_with(parent, name)
        leave_parent(output, errors)
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        gc.freeze()  # what is shared with the parent is not looked through, and so not copied
        code = _code_of(run)
        for thread in threading.enumerate():
            if thread is not threading.current_thread() and not thread.daemon:
                thread.join()
    except BaseException:  # nothing of the parent's may catch it
        traceback.print_exc()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):  # nobody reads it any longer
            stream.flush()
    os._exit(code)


def leave_parent(output: int, errors: int) -> None:
    """Have a session, signal handlers, standard streams and files of its own; call it in a child after fork.

    ``output``: file number that becomes standard output; ``errors``: the same of standard error.
    """
    os.setsid()
    hand_on_niceness(os.getpid())
    forget_handlers()
    _own_streams(output, errors)


def forget_handlers() -> None:
    """Handle signals as a new Python does: those that the parent ignores are ignored."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _own_streams(output: int, errors: int) -> None:
    """Have no input, these two outputs, and no other file of the parent's."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    # one of them may have a number of these, if the parent had no streams
    for place, number in enumerate([_above(each) for each in (nothing, output, errors)]):
        os.dup2(number, place)
    for number in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        if number > _LAST_STREAM:
            with contextlib.suppress(OSError):  # the one that was open to list them
                os.close(number)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)


def _above(number: int) -> int:
    """The same file under a number above those of the streams."""
    return fcntl.fcntl(number, fcntl.F_DUPFD, _LAST_STREAM + 1)


def _code_of(run: Callable[[], object]) -> int:
    """Exit status with which a Python program ends that does this."""
    try:
        run()
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        print(ended.code, file=sys.stderr)
        return 1
    return 0
