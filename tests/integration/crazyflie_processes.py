"""Starts the verbs of ``flightstack bridge``, reads what they say, and flies through them."""

from __future__ import annotations

import select
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tests.crazyflie_firmware.server import Server
from tests.integration.runs import COMMAND
from tests.integration.sim_processes import PATIENCE_S, ROOT, Client, is_a, setpoint

OFFBOARD, HOLD = 0x00060000, 0x03040000


class Verb:
    """A process of ``flightstack bridge`` and its output."""

    def __init__(self, *arguments: str) -> None:
        self.lines: list[str] = []
        self.child = subprocess.Popen(
            [*COMMAND, "bridge", *arguments],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert self.child.stdout is not None
        assert select.select([self.child.stdout], [], [], PATIENCE_S)[0], "no ready line"
        ready = self.child.stdout.readline().strip()
        assert ready.startswith("ready"), ready
        self.url = ready.removeprefix("ready ")
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self.lines.append(line)

    def said(self, words: str) -> bool:
        return any(words in line for line in list(self.lines))

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        if self.child.poll() is None:
            self.child.send_signal(number)
        return self.child.wait(2 * PATIENCE_S)


@contextmanager
def verb(*arguments: str) -> Iterator[Verb]:
    started = Verb(*arguments)
    try:
        yield started
    finally:
        if started.child.poll() is None:
            started.child.kill()
        started.child.wait(PATIENCE_S)


@contextmanager
def bridge(server: Server, *arguments: str) -> Iterator[Verb]:
    with verb("crazyflie", "--uri", server.uri, "--url", "udpin:127.0.0.1:0", *arguments) as started:
        yield started


@contextmanager
def client(started: Verb) -> Iterator[Client]:
    one = Client(started.url)
    try:
        one.hello()
        yield one
    finally:
        one.close()


def fly(one: Client, server: Server) -> None:
    """Armed, taken off, in OFFBOARD with a stream of zeros."""
    ready = lambda m: is_a("SYS_STATUS")(m) and m.onboard_control_sensors_health & 0x10000000  # noqa: E731
    one.until(ready, each=one.hello)
    armed = lambda m: m.get_type() == "HEARTBEAT" and m.base_mode & 0x80  # noqa: E731
    # a machine that stops for a moment makes poses stale, and arming is refused: as a pilot would, ask again
    one.until(armed, each=lambda: one.send(one.command(400, 1.0)))
    one.send(one.command(22))
    one.until(is_a("COMMAND_ACK", command=22, result=0))
    one.until(is_a("HEARTBEAT", custom_mode=HOLD), each=one.hello)
    one.send(setpoint(), one.command(176, 1.0, 6.0))
    one.until(is_a("HEARTBEAT", custom_mode=OFFBOARD), each=lambda: one.send(setpoint()))
    assert server.firmware.plant.position[2] > 0.3
