"""Starts ``flightstack`` as a person would, and reads what it says."""

import contextlib
import json
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from flightstack.cli.main import main
from tests.integration.sim_processes import COMMAND, wait_for
from tests.processes.bounded import killed, lines_of
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


class Flying:
    """A run in the background, to be disturbed."""

    def __init__(self, out: Path, *arguments):
        self.out = out
        self.process = subprocess.Popen(
            [*COMMAND, "sitl", "--no-report", "--out", str(out), *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.lines = []

    def wait_for(self, word: str) -> None:
        """Read its output until a line holds the word; it is killed if none does."""
        try:
            for line in lines_of(self.process.stdout, WALL_MAX_S):
                self.lines.append(line.rstrip())
                if word in line:
                    return
        except AssertionError as error:
            self.kill()
            raise AssertionError(f"{word!r} did not come: {self.lines}") from error
        raise AssertionError(f"ended without {word!r}: {self.lines}")

    def some_log(self, some_bytes: int = SOME_BYTES) -> Path:
        """The log, once there is something in it: on a busy machine the recorder is behind the flight."""
        log = self.out / "flight.mcap"
        wait_for(lambda: log.stat().st_size > some_bytes, "a log that grows")
        return log

    def children(self) -> dict[str, int]:
        """Process ids of the run by the name that the system shows: the verb, and of which vehicle."""
        pid = self.process.pid
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return {Path(f"/proc/{child}/comm").read_text().strip(): int(child) for child in children}

    def end(self) -> int:
        """Wait for its end, bounded; the exit status."""
        try:
            self.lines += self.process.communicate(timeout=WALL_MAX_S)[0].splitlines()
        finally:
            self.kill()
        return self.process.returncode

    def kill(self) -> None:
        """Kill it, unless it has ended."""
        self.lines += killed(self.process).splitlines()


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    """Send a signal."""
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
