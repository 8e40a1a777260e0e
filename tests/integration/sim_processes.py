"""Starts and ends processes of the simulator, and exchanges messages with them; every wait has a time-out."""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from flightstack.common.pacing import ask_for_priority, give_up_priority
from sim.runners.world_process import target_main, world_main
from sim.scenarios.scenario import load
from tests.processes.bounded import AT_ONCE_S, PATIENCE_S, killed, line_of
from tests.processes.started import Started, run_verb

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, "-m", "flightstack.cli.main"]
NAN = float("nan")


@contextmanager
def running(
    child: Started, *, ready: bool = True, within_s: float = PATIENCE_S
) -> Iterator[tuple[Started, str]]:
    """Run a process within the context, and kill it at the end; yield the process and its ready line.

    ``ready``: whether the process prints a ready line; without it, the yielded line is empty.
    """
    try:
        yield child, line_of(child.stdout, within_s).strip() if ready else ""
    finally:
        killed(child)


def verb(*words: object, cwd: Path = ROOT, **more: Any):
    """Run a subcommand of ``flightstack`` as a process; see ``running``."""
    return running(Started(run_verb, [*map(str, words)], cwd=cwd), **more)


def process(name: str, **options: object):
    """Run world, vehicle or target with the scenario paper_moving_1 as a process; see ``running``."""
    return running(Started(_simulate, name, options, cwd=ROOT))


def _simulate(name: str, options: dict[str, object]) -> None:
    kind = getattr(import_module("sim.options"), f"{name.title()}Options")
    plugged, main = (
        kind(scenario="paper_moving_1", **options),
        target_main if name == "target" else world_main,
    )
    sys.exit(main(load("paper_moving_1"), plugged))


def terminate(child: Started, number: signal.Signals = signal.SIGTERM) -> None:
    """Send a signal; the process must then end at once with status 0."""
    child.send_signal(number)
    assert child.wait(AT_ONCE_S) == 0


def priority_or_skip() -> None:
    """Skip the test if the system does not grant a higher priority."""
    if not ask_for_priority():
        pytest.skip("this system gives no priority: its tests run without it")
    give_up_priority()


def prompt_threads(pid: int) -> set[int]:
    """Return the threads of a process whose priority is above that of ordinary programs."""
    found = set()
    for each in Path(f"/proc/{pid}/task").iterdir():
        with suppress(ProcessLookupError):  # the thread may have ended
            if os.sched_getscheduler(int(each.name)) == os.SCHED_FIFO:
                found.add(int(each.name))
    return found


class Client:
    """A MAVLink client that uses a socket and pymavlink's parser, and no code of this project."""

    def __init__(self, url: str, system: int = 1, component: int = 191, *, listen: bool = False) -> None:
        kind, host, port = url.split(":")
        assert kind == "udpin"
        self._to = (host, int(port))
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(self._to if listen else ("127.0.0.1", 0))
        self._mav = mav.MAVLink(None, system, component)
        self.frames: list[bytes] = []
        self.log: list = []

    def send(self, *messages) -> None:
        data = b""
        for message in messages:
            data += message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
        self._socket.sendto(data, self._to)

    def hello(self) -> None:
        self.send(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))

    def command(self, number: int, *params: float):
        return mav.MAVLink_command_long_message(1, 1, number, 0, *params, *[NAN] * (7 - len(params)))

    def receive(self, timeout_s: float = PATIENCE_S) -> list:
        """Return the messages of the next datagram; the list is empty after a time-out."""
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return []
        data, self._to = self._socket.recvfrom(65536)
        messages = self._mav.parse_buffer(data) or []
        self.frames += [bytes(m.get_msgbuf()) for m in messages]
        self.log += messages
        return messages

    def until(self, wanted: Callable[[object], bool], timeout_s: float = PATIENCE_S, each=None):
        """Return the first matching message; call ``each`` after every datagram."""
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            for message in self.receive(0.1):
                if wanted(message):
                    return message
            if each is not None:
                each()
        raise AssertionError("the message waited for did not come")

    def close(self) -> None:
        self._socket.close()


def is_a(name: str, **fields) -> Callable[[object], bool]:
    """Return a predicate: a message of this type with these field values."""
    return lambda m: m.get_type() == name and all(getattr(m, k) == v for k, v in fields.items())


def setpoint(north=0.0, east=0.0, down=0.0):
    zeros = (0.0, 0.0, 0.0)
    return mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 2503, *zeros, north, east, down, *zeros, 1.5708, 0.0
    )
