"""Runs third-party clients against a vehicle process, and observes the vehicle with an independent client.

Every wait has a time-out and ends on an observation: a printed line, or telemetry.
"""

from __future__ import annotations

import math
import os
import re
import select
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from pymavlink.dialects.v20 import ardupilotmega as mav

from tests.integration.sim_processes import ROOT, Client, terminate, verb

SCENARIO = "paper_static_1"  # starts on the ground; the target does not move, no wind
READY_MAX_S = 240.0  # compilation of the simulator may be necessary, next to other compilers
STEP_MAX_S = 60.0  # time-out of one step on a busy machine
END_MAX_S = 30.0
DOCUMENTATION = ROOT / "docs" / "how_to" / "clients.md"
ARMED = mav.MAV_MODE_FLAG_SAFETY_ARMED
ON_GROUND = mav.MAV_LANDED_STATE_ON_GROUND
OFFBOARD, TAKEOFF, HOLD, LAND = 0x00060000, 0x02040000, 0x03040000, 0x06040000  # PX4 px4_custom_mode.h
_BEAT_S = 1.0


@contextmanager
def vehicle(*more: str) -> Iterator[int]:
    """Run ``flightstack vehicle`` on a free loopback port, which is yielded; it must also end in order."""
    words = ("vehicle", "--scenario", SCENARIO, "--url", "udpin:127.0.0.1:0", *more)
    with verb(*words, within_s=READY_MAX_S) as (child, ready):
        yield int(ready.rsplit(":", 1)[1])
        terminate(child)


class Observer(Client):
    """A client that sends only heartbeats and stores received messages."""

    def __init__(self, port: int) -> None:
        super().__init__(f"udpin:127.0.0.1:{port}")
        self._beat_due_s = -math.inf

    def beat(self) -> None:
        """Send a heartbeat once a second."""
        now_s = time.monotonic()
        if now_s >= self._beat_due_s:
            self._beat_due_s = now_s + _BEAT_S
            self.hello()

    def drain(self) -> None:
        while self.receive(0.0):
            pass

    def fileno(self) -> int:
        """Descriptor of the socket, for ``select``."""
        return self._socket.fileno()

    def all(self, name: str, since: int = 0) -> list:
        """Return the messages of one type, from an index of the log on."""
        return [m for m in self.log[since:] if m.get_type() == name]

    def last(self, name: str):
        """Return the newest message of one type, None if there is none."""
        return next((m for m in reversed(self.log) if m.get_type() == name), None)

    @property
    def position(self):
        found = self.last("LOCAL_POSITION_NED")
        assert found is not None, "no position yet"
        return found

    def modes(self, since: int = 0) -> list[int]:
        """Return the custom modes in their order, each change once."""
        return _changes([m.custom_mode for m in self.all("HEARTBEAT", since)])

    def armings(self, since: int = 0) -> list[bool]:
        """Return the arming states in their order, each change once."""
        return _changes([bool(m.base_mode & ARMED) for m in self.all("HEARTBEAT", since)])

    def texts(self, since: int = 0) -> list[str]:
        return [m.text for m in self.all("STATUSTEXT", since)]


def _changes(values: list) -> list:
    return [v for i, v in enumerate(values) if i == 0 or v != values[i - 1]]


class Program:
    """A client program; its output is read, and lines are written to its standard input."""

    def __init__(self, command: Sequence[str], watch: Observer, **more) -> None:
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **more
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._stdin, self._stdout = self._child.stdin, self._child.stdout
        self._watch = watch
        self._open = True
        self.output = ""
        self.typed: list[str] = []
        self._read_to = 0

    def __enter__(self) -> Program:
        return self

    def __exit__(self, kind, error, trace) -> None:
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait(END_MAX_S)
        for pipe in (self._stdin, self._stdout):
            pipe.close()
        if error is not None:
            error.add_note(self.said())

    def said(self) -> str:
        """Return all its output, and the vehicle's texts, for error messages."""
        vehicle_said = "\n".join(self._watch.texts())
        return f"--- the client printed\n{self.output}\n--- the vehicle said\n{vehicle_said}"

    def send(self, line: str) -> None:
        self.typed.append(line)
        self._stdin.write(f"{line}\n".encode())
        self._stdin.flush()

    def hang_up(self) -> None:
        self._stdin.close()

    def pump(self, timeout_s: float) -> None:
        """Read output of the program and messages of the vehicle; wait briefly if there are none."""
        self._watch.beat()
        sources = [self._watch, self._stdout] if self._open else [self._watch]
        ready = select.select(sources, [], [], timeout_s)[0]
        if self._watch in ready:
            self._watch.drain()
        if self._stdout in ready:
            data = os.read(self._stdout.fileno(), 65536)
            self._open = bool(data)
            self.output += data.decode(errors="replace")

    def until(
        self,
        done: Callable[[], object],
        what: str,
        within_s: float = STEP_MAX_S,
        each: Callable[[], None] | None = None,
    ) -> None:
        """Continue until ``done``, evaluated after each message or line; so is ``each``, and every 0.05 s."""
        deadline_s = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < deadline_s, f"{what}: not within {within_s:g} s"
            assert self._open, f"{what}: the client has ended"
            if each is not None:
                each()
            self.pump(0.05)

    def expect(self, pattern: str, within_s: float = STEP_MAX_S, each: Callable[[], None] | None = None):
        """Wait for new output that matches; return the match."""
        compiled = re.compile(pattern)
        self.until(lambda: compiled.search(self.output, self._read_to), f"{pattern!r}", within_s, each)
        match = compiled.search(self.output, self._read_to)
        assert match is not None
        self._read_to = match.end()
        return match

    def end(self, within_s: float = END_MAX_S) -> int:
        """Wait for its end; return the exit status."""
        self.until(lambda: not self._open, "its end", within_s)
        return self._child.wait(END_MAX_S)
