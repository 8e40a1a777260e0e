"""Starts processes of tests as forks of a process in which all modules are loaded; this saves time.

``Flying``, the commands of the docs and ``subprocess`` start new programs, as users do.
"""

from __future__ import annotations

import multiprocessing
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

from flightstack.cli.main import main
from flightstack.common.processes import Child, leave_parent

SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["tests.processes.loaded"])


class Started:
    """A process with the methods of ``subprocess.Popen`` that tests use; pipes carry its output.

    Args:
        run: function that the process runs.
        given: arguments of the function.
        cwd: working folder.
        text: whether the output is read as text.
        errors: file for the standard error; None: a pipe.
    """

    stdin = None

    def __init__(
        self,
        run: Callable[..., object],
        *given: object,
        cwd: Path | None = None,
        text: bool = True,
        errors: IO[bytes] | None = None,
    ) -> None:
        out, to_out = SERVER.Pipe(duplex=False)
        err, to_err = SERVER.Pipe(duplex=False)
        told = to_err if errors is None else Connection(os.dup(errors.fileno()), readable=False)
        about = (cwd or Path.cwd(), dict(os.environ), os.getpriority(os.PRIO_PROCESS, 0))
        self._process = SERVER.Process(target=_begin, args=(run, given, about, to_out, told))
        self._process.start()
        for theirs in (to_out, to_err, told):
            theirs.close()
        kind = "r" if text else "rb"
        self.stdout, self.stderr = (os.fdopen(os.dup(one.fileno()), kind) for one in (out, err))
        assert self._process.pid is not None
        self.pid = self._process.pid

        self.terminate, self.kill = self._process.terminate, self._process.kill

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if (code := self._process.exitcode) is None:
            raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def communicate(self, timeout: float) -> tuple[Any, Any]:
        """Read the output to its end, and wait for the end of the process.

        Raises subprocess.TimeoutExpired: the process runs longer than the given time.
        """
        until_s, said = time.monotonic() + timeout, {self.stdout: b"", self.stderr: b""}
        with selectors.DefaultSelector() as selector:
            for stream in said:
                if not stream.closed:
                    selector.register(stream, selectors.EVENT_READ)
            while selector.get_map():
                left_s = until_s - time.monotonic()
                if left_s <= 0.0:
                    raise subprocess.TimeoutExpired(f"process {self.pid}", timeout)
                for key, _ in selector.select(left_s):
                    data = os.read(key.fd, 65536)
                    said[key.fileobj] += data  # type: ignore[index]
                    if not data:
                        selector.unregister(key.fileobj)
        self.wait(max(0.0, until_s - time.monotonic()))
        out, err = (said[stream] for stream in (self.stdout, self.stderr))
        return (
            (out.decode(errors="replace"), err.decode(errors="replace"))
            if "b" not in self.stdout.mode
            else (out, err)
        )


class StartedChild(Child):
    """A ``Child`` that is forked by ``Started``, because a test worker has threads and must not fork."""

    def _program(self, arguments, program, works_in, errors):
        if program is not None:
            return super()._program(arguments, program, works_in, errors)
        return Started(run_verb, list(arguments), text=False, errors=errors)


def run_verb(words: Sequence[str]) -> None:
    main(list(words), prog_name="flightstack")


def _begin(
    run: Callable[..., object], given: Sequence[Any], about: tuple[Path, dict[str, str], int],
    output: Connection, errors: Connection,
) -> None:  # fmt: skip
    """Make the forked child independent of its parent, and run the function."""
    folder, environment, nice = about
    os.setpriority(os.PRIO_PROCESS, 0, nice)
    leave_parent(output.fileno(), errors.fileno())
    os.chdir(folder)
    sys.path.insert(0, str(folder))  # ``python -m``, too, puts the current folder first
    os.environ.clear()
    os.environ.update(environment)
    run(*given)
