"""Starts ``flightstack`` as a user does, and reads its output."""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from flightstack.cli.main import main
from tests.integration.sim_processes import COMMAND, ROOT
from tests.processes.bounded import PATIENCE_S, killed
from tests.processes.started import Started, run_verb

WALL_MAX_S = 240.0
# Subcommands that start no process and handle no signal run in this process, because a new process needs one
# to three seconds to load their packages.
CALLED = {
    "check",
    "compare",
    "config",
    "identify",
    "key",
    "log",
    "preflight",
    "replay",
    "report",
    "scenarios",
}


@dataclass
class Result:
    """Exit status and output of a finished run."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict:
        return json.loads(self.out.strip().splitlines()[-1])


def flightstack(*arguments, cwd=None, apart=False) -> Result:
    """Run a subcommand to its end; ``apart``: in a separate process in any case."""
    words = [str(one) for one in arguments]
    if not apart and (words[0] in CALLED or "--help" in words):
        return called(*words, cwd=cwd)
    child = Started(run_verb, words, cwd=cwd)
    try:
        out, err = child.communicate(WALL_MAX_S)
    finally:
        killed(child)
    return Result(child.returncode, out, err)


def called(*arguments, cwd=None) -> Result:
    """Run a subcommand in this process; it starts no process, or its arguments are rejected."""
    with contextlib.chdir(cwd or Path.cwd()):
        done = CliRunner().invoke(main, [str(one) for one in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return Result(done.exit_code, done.stdout, done.stderr)


def fly(out: Path, scenario: str, seed: int = 0, *more) -> Result:
    words = ["sitl", "--scenario", scenario, "--seed", seed, "--lockstep", "--json", "--no-report"]
    return flightstack(*words, "--out", out, *more)


def replayed(log: Path, *, apart: bool = False) -> dict:
    """Replay a log with its recorded MAVLink and Zenoh data; return the result.

    The replayed decisions and inputs must equal the recorded decisions and inputs.
    """
    done = flightstack("replay", log, "--check", "--json", apart=apart)
    assert done.code == 0, done.out + done.err
    found = done.json
    assert found["result"] == "equal"
    assert found["wire"] == {"count": 0, "ticks": 0, "first": []}
    return found


def rrd_reader(path: Path):
    """Return the reader of a recording of Rerun."""
    from rerun.chunk import RrdReader  # late import: it takes 0.4 s in each worker

    return RrdReader(path)


def entities(path: Path) -> tuple[Counter[str], dict[str, set[str]]]:
    """Return, by entity of a Rerun recording, the number of rows with a time, and the names of columns."""
    rows: Counter[str] = Counter()
    columns: dict[str, set[str]] = {}
    for chunk in rrd_reader(path).store().stream().to_chunks():
        rows[chunk.entity_path] += 0 if chunk.is_static else chunk.num_rows
        columns.setdefault(chunk.entity_path, set()).update(chunk.to_record_batch().schema.names)
    return rows, columns


class Background:
    """A subcommand that runs during the test: its output so far, line by line, and its exit."""

    def __init__(self, *arguments: object) -> None:
        self.process = subprocess.Popen(
            [*COMMAND, *map(str, arguments)],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
        )  # fmt: skip
        self.lines: list[str] = []
        self._looked = 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line.rstrip())

    def said(self, words: str) -> bool:
        return any(words in line for line in list(self.lines))

    def until(self, *words: str, each: Callable[[], object] = lambda: None) -> str:
        """Return the next printed line with all words; if there is none, kill the process and fail.

        ``each``: function that is called before each check.
        """
        until_s, more = time.monotonic() + WALL_MAX_S, True
        while more and time.monotonic() < until_s:
            each()
            self._reader.join(0.02)
            more = self._reader.is_alive()  # ask first; otherwise the last lines could be missed
            while self._looked < len(self.lines):
                self._looked += 1
                if all(word in self.lines[self._looked - 1] for word in words):
                    return self.lines[self._looked - 1]
        self.kill()
        raise AssertionError(f"no line with {words}: {self.lines}")

    def end(self, number: int | None = None) -> int:
        """Wait, with a time-out, until process and output have ended; return the exit status.

        ``number``: signal to send first.
        """
        if number is not None:
            self.process.send_signal(number)
        try:
            code = self.process.wait(WALL_MAX_S)
            self._reader.join(PATIENCE_S)
            assert not self._reader.is_alive(), f"what it started outlives it: {self.lines}"
        finally:
            self.kill()
        return code

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        if not self._reader.is_alive():
            assert self.process.stdout is not None
            self.process.stdout.close()

    def pids(self) -> list[int]:
        """Return the ids of the child processes of this subcommand."""
        pid = self.process.pid
        return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]

    def children(self) -> dict[str, int]:
        """Return the ids of the child processes by name (subcommand and vehicle)."""
        return {Path(f"/proc/{pid}/comm").read_text().strip(): pid for pid in self.pids()}


class Flying(Background):
    """A run of ``sitl``, for tests that disturb it."""

    def __init__(self, out: Path, *arguments: object) -> None:
        self.out = out
        super().__init__("sitl", "--no-report", "--out", out, *arguments)


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    os.kill(pid, number)
