"""Child processes of one run, forked or started as programs: start, supervision, and end in order."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import gc
import os
import random
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from multiprocessing import process
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import IO, Any

_PR_SET_PDEATHSIG = 1  # number of a prctl operation (linux/prctl.h)
_PR_SET_NAME = 15
_NAME_BYTES = 15  # maximum length of a thread name that Linux stores, bytes
_LAST_STREAM = 2  # file descriptor of standard error
START_MAX_S = 900.0  # maximum time for a child to start, s; a slow computer loads and compiles for minutes
CLI = "flightstack.cli.main"  # module of the command-line program
_WRONG_INPUT = 2  # exit status of every command after wrong input
# A function between fork and exec could wait without end for locks of the parent's threads (Zenoh).
# Therefore a small Python program calls the kernel before it executes the child's program.
_TIE = (
    f"import ctypes, os, sys; ctypes.CDLL(None).prctl({_PR_SET_PDEATHSIG}, int(sys.argv[1])); "
    "os.getppid() == int(sys.argv[2]) or sys.exit(1); os.execvp(sys.argv[3], sys.argv[3:])"
)
END_TIME_MAX_S = 10.0  # time from SIGTERM to SIGKILL of a child, s
CLOSE_TIME_MAX_S = 60.0  # maximum time for the recorder to end, s; the disk can be slow


_SOCKET_PATH_MAX = 107  # maximum length of a Unix socket's path, bytes (unix(7))


class LaunchError(RuntimeError):
    """A process did not start, or ended too early; the text contains its output."""

    def __init__(self, text: str, code: int = 1) -> None:
        super().__init__(text)
        # exit status of the launcher: 2 after wrong input of the child, otherwise 1
        self.code = 2 if code == _WRONG_INPUT else 1


def socket_folder() -> Path:
    """Return a new private folder for sockets: in ``TMPDIR``, or in /tmp if their paths would be too long."""
    folder = Path(tempfile.mkdtemp(prefix="flightstack-"))
    if len(os.fsencode(folder / "recorder")) > _SOCKET_PATH_MAX:
        folder.rmdir()
        folder = Path(tempfile.mkdtemp(prefix="flightstack-", dir="/tmp"))
    return folder


class Child:
    """One process of the run; its standard error is written to the file ``name``.txt in ``folder``.

    Without ``program``, the child runs a command of ``flightstack``. The child is then a fork of this
    process, which has already loaded the modules; if a fork is not possible, the child is a new program.
    """

    end_signal = signal.SIGTERM  # signal that a program receives when this process ends
    lines_max = 5  # maximum number of lines in ``errors``

    def __init__(
        self, name: str, arguments: Sequence[str], folder: Path, *,
        program: Sequence[str | Path] | None = None, works_in: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self.name = name
        self.output = folder / f"{name}.txt"
        with self.output.open("wb") as errors:
            if program is None and may_fork():
                run = partial(import_module(CLI).main, list(arguments), prog_name="flightstack")
                self.process: subprocess.Popen[bytes] | Forked = Forked(name, run, errors)
            else:
                self.process = subprocess.Popen(
                    [*tied(program or [sys.executable, *_path(), "-m", CLI], self.end_signal), *arguments],
                    cwd=works_in,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=errors,
                    start_new_session=True,  # only the launcher receives Ctrl-C, and then ends the children
                )
                hand_on_niceness(self.process.pid)
        assert self.process.stdout is not None
        assert self.process.pid is not None
        self.pid = self.process.pid
        os.set_blocking(self.process.stdout.fileno(), False)
        self._text = b""
        self._read: list[str] = []  # lines that followed the line ``ready`` in the same read

    def yield_to_others(self, steps: int) -> None:
        """Raise the niceness of the process to ``steps``, so that it does not delay the flight."""
        with contextlib.suppress(OSError):  # after a failure the priority is unchanged
            os.setpriority(os.PRIO_PROCESS, self.pid, steps)

    def wait_ready(self) -> str:
        """Wait for the line ``ready ...``; return its remainder. Raises LaunchError: no such line in time."""
        until = time.monotonic() + START_MAX_S
        try:
            waits = True
            while waits:
                waits, lines = self.alive() and time.monotonic() < until, self.lines(0.1)
                for number, line in enumerate(lines):
                    if line.startswith("ready"):
                        self._read = lines[number + 1 :]
                        return line.removeprefix("ready").strip()
        except BaseException:  # the child must end after a signal, too; no other code ends it
            self.end()
            raise
        hung, code = self.alive(), self.end()
        why = f"not ready within {START_MAX_S:g} s" if hung else self.errors()
        raise LaunchError(f"{self.name} did not start: {why}", code)

    def lines(self, timeout_s: float) -> list[str]:
        """Return the complete lines of output that arrive within ``timeout_s``."""
        assert self.process.stdout is not None
        read, self._read = self._read, []
        if select.select([self.process.stdout], (), (), 0.0 if read else timeout_s)[0]:
            self._text += self.process.stdout.read() or b""
        *whole, self._text = self._text.split(b"\n")
        return read + [line.decode(errors="replace") for line in whole]

    def errors(self) -> str:
        """Return the last lines of the process's standard error."""
        lines = self.output.read_text(errors="replace").strip().splitlines()[-self.lines_max :]
        return "\n".join(lines) or "no reason given"

    def alive(self) -> bool:
        return self.process.poll() is None

    def end(self, within_s: float = END_TIME_MAX_S) -> int:
        """End the process by SIGTERM, after ``within_s`` by SIGKILL; return its exit status."""
        code = ended(self.process, within_s)
        if self.process.stdout is not None:
            self.process.stdout.close()
        return code


def _path() -> list[str]:
    """Return ``-P`` (no imports from the working folder), unless this process imports from that folder."""
    return [] if sys.path[0] in ("", str(Path.cwd())) else ["-P"]


def ended(process: subprocess.Popen[Any] | Forked, within_s: float = END_TIME_MAX_S) -> int:
    """End a process by SIGTERM, after ``within_s`` by SIGKILL; return its exit status."""
    if process.poll() is None:
        process.terminate()
    for _ in range(2):
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(within_s)
        process.kill()
    return -signal.SIGKILL  # the process is blocked in the kernel, for example by a disk that does not reply


def tied(program: Sequence[str | Path], number: signal.Signals = signal.SIGTERM) -> list[str]:
    """Return a command line for a program; on Linux the kernel signals the program when this process ends."""
    if sys.platform != "linux":
        return [*map(str, program)]
    return [sys.executable, "-ISc", _TIE, str(int(number)), str(os.getpid()), *map(str, program)]


class Port:
    """TCP port on loopback for a later server; other runs cannot take the port while this object is open.

    If the kernel chose the port (bind to port 0), an outgoing connection could take the port a moment later.
    The ports of this class are below the range of outgoing connections. A bound UDP socket with the same
    number reserves each port.
    """

    _RANGE = range(20_000, 32_000)  # Linux uses outgoing ports from 32768 on (ip_local_port_range)
    _TRIES = 200

    def __init__(self) -> None:
        for number in random.SystemRandom().sample(self._RANGE, self._TRIES):
            reservation = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            try:
                reservation.bind(("127.0.0.1", number))
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", number))
            except OSError:
                reservation.close()
                continue
            self.number, self.close = number, reservation.close
            self.endpoint = f"tcp/127.0.0.1:{number}"  # Zenoh endpoint of the port
            return
        raise LaunchError(f"no free port of loopback found in {self._TRIES} tries from {self._RANGE}")


def may_fork() -> bool:
    """Whether a fork is safe: only on Linux and without other threads, whose locks a child cannot release."""
    if sys.platform != "linux" or threading.current_thread() is not threading.main_thread():
        return False
    return len(list(Path("/proc/self/task").iterdir())) == 1


def hand_on_niceness(pid: int) -> None:
    """Apply the niceness of this process to the session of a child, or to its own session.

    Linux schedules sessions before processes (sched(7), autogroup), and a new session has niceness 0: without
    this call, ``nice`` would have no effect on other programs.
    """
    steps = os.getpriority(os.PRIO_PROCESS, 0)
    if steps > 0:
        with contextlib.suppress(OSError):  # no autogroups exist, or a second change within 0.1 s failed
            Path(f"/proc/{pid}/autogroup").write_text(str(steps))


class Forked(ForkProcess):
    """Forked process with those methods of ``subprocess.Popen`` that this package uses.

    The process has its own session, signal handlers, standard streams and files; it ends like any program.
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
        # the owner ends the child in bounded time; multiprocessing would wait at exit without a limit
        process._children.discard(self)  # type: ignore[attr-defined]
        self.stdout: IO[bytes] | None = os.fdopen(output, "rb")  # standard output of the child

    def run(self) -> None:
        """Run the function in the child; the kernel ends the child if its parent is killed."""
        kernel = ctypes.CDLL(None)
        kernel.prctl(_PR_SET_NAME, self.name.encode()[:_NAME_BYTES])  # the name that ``ps -e`` shows
        kernel.prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM))
        if os.getppid() != self._parent_pid:  # type: ignore[attr-defined]  # the parent was already killed
            os._exit(1)
        leave_parent(self._output, self._errors)
        signal.pthread_sigmask(signal.SIG_SETMASK, self._blocked)
        gc.freeze()  # the collector then does not scan memory shared with the parent, so no page is copied
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
    """Detach a forked child: new session, default signals, no inherited files, own standard streams."""
    os.setsid()
    hand_on_niceness(os.getpid())
    forget_handlers()
    streams = os.open(os.devnull, os.O_RDONLY), output, errors
    # if the parent had no standard streams, these descriptors can have the numbers 0 to 2
    above = [fcntl.fcntl(number, fcntl.F_DUPFD, _LAST_STREAM + 1) for number in streams]
    for place, number in enumerate(above):
        os.dup2(number, place)
    for number in [int(each.name) for each in Path("/proc/self/fd").iterdir()]:
        if number > _LAST_STREAM:
            with contextlib.suppress(OSError):  # the descriptor of the directory listing is already closed
                os.close(number)
    sys.stdin = os.fdopen(0, closefd=False)
    sys.stdout = os.fdopen(1, "w", closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace", closefd=False)


def forget_handlers() -> None:
    """Set the signal handling of a new Python process; signals that the parent ignores remain ignored."""
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
