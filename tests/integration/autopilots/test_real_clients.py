"""Tests MAVProxy (typed lines) and MAVSDK (the program of docs/how_to/clients.md) with the vehicle process.

An independent client observes the vehicle. Each wait ends with printed output or telemetry, or by a time-out.
"""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.integration.sim_processes import ROOT, Client, terminate, verb
from tests.processes.ports import free_port

pytestmark = pytest.mark.xdist_group("real-time")

PAGE = (ROOT / "docs" / "how_to" / "clients.md").read_text()
READY_MAX_S = 240.0  # time-out of the start, s; the simulator may have to be compiled
STEP_MAX_S = 60.0  # time-out of one step on a busy machine, s
EXAMPLE_MAX_S = 180.0
OFFBOARD, TAKEOFF, HOLD, LAND = 0x00060000, 0x02040000, 0x03040000, 0x06040000  # codes of px4_custom_mode.h
LEG_M, SPEED_M_S = 0.5, 0.3
WEST, NORTH = (lambda m: -m.y), (lambda m: m.x)  # the nose points east: west is backwards, north is left
OFFBOARD_LINE = "long DO_SET_MODE 157 6 0"
# typed line; expected output, or coordinate that must grow by LEG_M; line that is typed until this happens
STEPS = (
    ("param set COM_OF_LOSS_T 2", r"COM_OF_LOSS_T = 2\.0", "param fetch COM_OF_LOSS_T"),
    ("param set MPC_XY_P 55", "AP: MPC_XY_P: 55, allowed 0.1 to 2", None),
    ("arm throttle", r"\bARMED", None),
    ("takeoff 0.5", "Mode LOITER", None),
    ("disarm", "AP: Disarming refused: not landed", None),
    (OFFBOARD_LINE, "AP: Mode offboard refused: no set-points", None),
    ("velocity 0 0 0", r"x:0\.0", None),
    (OFFBOARD_LINE, "Mode OFFBOARD", "velocity 0 0 0"),
    (f"velocity -{SPEED_M_S} 0 0", WEST, f"velocity -{SPEED_M_S} 0 0"),
    (f"velocity 0 -{SPEED_M_S} 0", NORTH, f"velocity 0 -{SPEED_M_S} 0"),
    ("long NAV_LAND", "DISARMED", None),
)


@contextmanager
def vehicle(*more: str):
    """Run ``flightstack vehicle`` on a free loopback port; yield an observer of the vehicle.

    The process must end without error.
    """
    words = ("vehicle", "--scenario", "paper_static_1", "--url", "udpin:127.0.0.1:0", *more)
    with verb(*words, within_s=READY_MAX_S) as (child, ready):
        watch = Observer(ready.removeprefix("ready "))
        yield watch
        watch.close()
        terminate(child)


class Observer(Client):
    """A client that sends only heartbeats and stores received messages."""

    def look(self) -> None:
        """Send a heartbeat, and read the messages that have arrived."""
        self.hello()
        while self.receive(0.0):
            pass

    def all(self, name: str) -> list:
        return [m for m in self.log if m.get_type() == name]

    def changes(self, value) -> list:
        """Return the values of a heartbeat field in order, without values equal to the previous value."""
        values = [value(m) for m in self.all("HEARTBEAT")]
        return [v for n, v in enumerate(values) if n == 0 or v != values[n - 1]]

    def modes(self) -> list[int]:
        return self.changes(lambda m: m.custom_mode)

    def armings(self) -> list[bool]:
        return self.changes(lambda m: bool(m.base_mode & 128))


class Program:
    """A client program; its output is read, and lines are written to its standard input."""

    def __init__(self, command, watch: Observer, **more) -> None:
        self.child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **more
        )
        self._watch, self._read_to = watch, 0
        self.output, self.open = "", True

    def __enter__(self) -> Program:
        return self

    def __exit__(self, kind, error, trace) -> None:
        self.child.kill()
        self.child.wait(STEP_MAX_S)
        for pipe in (self.child.stdin, self.child.stdout):
            pipe.close()
        if error is not None:
            error.add_note(
                f"--- the client printed\n{self.output}\n--- the vehicle: {self._watch.all('STATUSTEXT')}"
            )

    def type(self, line: str) -> None:
        self.child.stdin.write(f"{line}\n".encode())
        self.child.stdin.flush()

    def until(self, done, what: str, repeat: str | None = None, within_s: float = STEP_MAX_S) -> None:
        """Read output and telemetry until ``done``; until then type ``repeat`` every 0.1 s."""
        deadline_s = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < deadline_s, f"{what}: not within {within_s:g} s"
            assert self.open, f"{what}: the client has ended"
            self._watch.look()
            if repeat is not None:
                self.type(repeat)
            if select.select([self.child.stdout], [], [], 0.1)[0]:
                data = os.read(self.child.stdout.fileno(), 65536)
                self.open = bool(data)
                self.output += data.decode(errors="replace")

    def expect(self, pattern: str, repeat: str | None = None) -> None:
        """Wait for new output that matches a pattern."""
        self.until(lambda: re.compile(pattern).search(self.output, self._read_to), pattern, repeat)
        self._read_to = re.compile(pattern).search(self.output, self._read_to).end()


def shape(line: str) -> str:
    """Return a line with each number replaced by #."""
    return re.sub(r"-?\b[\d.]+", "#", line)


def test_the_lines_of_the_page_fly_it_from_mavproxy(tmp_path: Path, flight_number: int) -> None:
    block = re.search(r"\$ mavproxy\.py .*?\n(.*?)```", PAGE, re.DOTALL)[1]
    assert {shape(line) for line in block.splitlines()} <= {shape(line) for line, _, _ in STEPS}
    with vehicle() as watch:
        command = [sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--state-basedir={tmp_path}"]
        command += [f"--master=udpout:127.0.0.1:{watch._to[1]}"]
        # MAVProxy reads start-up files from the home directory; they must not influence the test
        with Program(command, watch, env=os.environ | {"HOME": str(tmp_path)}, cwd=tmp_path) as program:
            program.expect("Detected vehicle 1:1 on link 0")
            program.expect(r"Received \d+ parameters")
            for line, wanted, repeat in STEPS:
                program.type(line)
                if isinstance(wanted, str):
                    program.expect(wanted, repeat)
                    continue
                begin, start_m = len(watch.log), wanted(watch.all("LOCAL_POSITION_NED")[-1])
                moved = lambda: wanted(watch.all("LOCAL_POSITION_NED")[-1]) > start_m + LEG_M  # noqa: B023, E731
                program.until(moved, line, repeat)
                places = [m for m in watch.log[begin:] if m.get_type() == "LOCAL_POSITION_NED"]
                speeds = [(m.vx**2 + m.vy**2) ** 0.5 for m in places]
                assert SPEED_M_S < max(speeds) < 1.7 * SPEED_M_S  # the paper's gains overshoot by a third
            program.until(lambda: watch.modes()[-1] == HOLD, "its end")
    assert watch.modes() == [HOLD, TAKEOFF, HOLD, OFFBOARD, LAND, HOLD]
    assert watch.armings() == [False, True, False]
    places = watch.all("LOCAL_POSITION_NED")
    assert max(-m.z for m in places) == pytest.approx(0.5, abs=0.15)
    assert -places[-1].z < 0.05
    assert watch.all("EXTENDED_SYS_STATE")[-1].landed_state == 1


def test_the_program_of_the_page_flies_it_by_mavsdk(tmp_path: Path, flight_number: int) -> None:
    port_there = free_port(udp=True)
    script = tmp_path / "example.py"
    text = re.search(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)[1]
    script.write_text(text.replace("0.0.0.0:14540", f"127.0.0.1:{port_there}"))
    with (
        vehicle("--peer", f"127.0.0.1:{port_there}") as watch,
        Program([sys.executable, str(script)], watch) as client,
    ):
        client.until(lambda: not client.open, "its end", within_s=EXAMPLE_MAX_S)
        assert client.child.wait(STEP_MAX_S) == 0
    # HOLD between two modes may be shorter than a tick
    assert [mode for mode in watch.modes() if mode != HOLD] == [TAKEOFF, OFFBOARD, LAND]
    assert watch.armings() == [False, True, False]
    assert max(m.x for m in watch.all("LOCAL_POSITION_NED")) > 0.0
