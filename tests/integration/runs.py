"""Starts ``flightstack`` as a person would, and reads what it says."""

import contextlib
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from flightstack.cli.main import main
from tests.integration.sim_processes import COMMAND, ROOT, wait_for
from tests.processes.bounded import PATIENCE_S, killed
from tests.processes.started import Started, run_verb

WALL_MAX_S = 240.0
# Verbs that start nothing and catch no signal: called in this process, which has loaded their packages
# already. A process of its own would load them for one to three seconds each time.
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
SOME_BYTES = 400_000  # of a log, which grows by 170 kB a second


@dataclass
class Result:
    """One ended run."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict:
        return json.loads(self.out.strip().splitlines()[-1])


def flightstack(*arguments, cwd=None, apart=False) -> Result:
    """Run a verb to its end; ``apart``: in a process of its own, whichever verb it is."""
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
    """Run a verb in this process: one that reads, or one that refuses its arguments."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        with contextlib.chdir(cwd or Path.cwd()):
            done = CliRunner().invoke(main, [str(one) for one in arguments])
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return Result(done.exit_code, done.stdout, done.stderr)


def fly(out: Path, scenario: str, seed: int = 0, *more) -> Result:
    """One lockstep run."""
    words = ["sitl", "--scenario", scenario, "--seed", seed, "--lockstep", "--json", "--no-report"]
    return flightstack(*words, "--out", out, *more)


def replayed(log: Path, *, apart: bool = False) -> dict:
    """Result of a replay that must decide at each tick what was decided, inputs from the wire included."""
    done = flightstack("replay", log, "--check", "--json", apart=apart)
    assert done.code == 0, done.out + done.err
    found = done.json
    assert found["result"] == "equal"
    assert found["wire"] == {"count": 0, "ticks": 0, "first": []}
    assert found["start"] == "tick 0"
    return found


class Background:
    """A verb that runs beside the test: what it has said so far, line by line, and its end."""

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
        """Whether a line holds these words."""
        return any(words in line for line in list(self.lines))

    def until(self, *words: str, each: Callable[[], object] = lambda: None) -> str:
        """The next line that holds all the words; it is killed if none does. ``each`` is called meanwhile."""
        until_s, more = time.monotonic() + WALL_MAX_S, True
        while more and time.monotonic() < until_s:
            each()
            self._reader.join(0.02)
            more = self._reader.is_alive()  # looked at before the lines, or the last ones were missed
            while self._looked < len(self.lines):
                self._looked += 1
                if all(word in self.lines[self._looked - 1] for word in words):
                    return self.lines[self._looked - 1]
        self.kill()
        raise AssertionError(f"no line with {words}: {self.lines}")

    def end(self, number: int | None = None) -> int:
        """Wait for its end and for that of all it says, bounded; the exit status.

        ``number``: signal that it is sent first, unless it has ended.
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
        """Process ids of what it has started."""
        pid = self.process.pid
        return [int(one) for one in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]

    def children(self) -> dict[str, int]:
        """The same by the name that the system shows: the verb, and of which vehicle."""
        return {Path(f"/proc/{pid}/comm").read_text().strip(): pid for pid in self.pids()}


class Flying(Background):
    """A run of ``sitl``, to be disturbed."""

    def __init__(self, out: Path, *arguments: object) -> None:
        self.out = out
        super().__init__("sitl", "--no-report", "--out", out, *arguments)

    def some_log(self, some_bytes: int = SOME_BYTES) -> Path:
        """The log, once there is something in it: on a busy machine the recorder is behind the flight."""
        log = self.out / "flight.mcap"
        wait_for(lambda: log.stat().st_size > some_bytes, "a log that grows")
        return log


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    os.kill(pid, number)


def gone(pid: int, within_s: float = 10.0) -> bool:
    """Whether a process has ended, waiting for it at most so long."""
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except FileNotFoundError:
            return True
        if state == "Z":
            return True
        time.sleep(0.02)  # polling another process: nothing to wait on
    return False
