"""MAVProxy and MAVSDK fly the vehicle process: by typed commands, and by the documentation's program."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.integration.autopilots.real_clients import (
    DOCUMENTATION,
    HOLD,
    LAND,
    OFFBOARD,
    ON_GROUND,
    TAKEOFF,
    Observer,
    Program,
    vehicle,
)
from tests.processes.ports import free_port

pytestmark = pytest.mark.xdist_group("real-time")

FETCH_MAX_S = 5.0  # time-out for all parameters; without a rejected file transfer it would be 12 s
SPEED_M_S = 0.3
LEG_M = 0.5
STREAM_S = 0.1  # time between two set-points
FETCH_S = 0.5  # time between two requests of a parameter


class Leg(NamedTuple):
    """A direction of flight, and distance and speed in LOCAL_POSITION_NED."""

    velocity_frd_m_s: tuple[float, float, float]
    way_m: Callable
    speed_m_s: Callable


LEGS = {  # the vehicle's nose points east
    "west": Leg((-SPEED_M_S, 0.0, 0.0), lambda m: -m.y, lambda m: -m.vy),
    "north": Leg((0.0, -SPEED_M_S, 0.0), lambda m: m.x, lambda m: m.vx),
}


@contextmanager
def mavproxy(port: int, directory: Path, watch: Observer, *more: str) -> Iterator[Program]:
    """Run MAVProxy without a display, with its files in ``directory``."""
    command = [sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--master=udpout:127.0.0.1:{port}"]
    command += [f"--state-basedir={directory}", *more]
    # It reads start-up files from the home directory, which must not influence a test.
    environment = os.environ | {"HOME": str(directory)}
    with Program(command, watch, env=environment, cwd=directory) as program:
        yield program
        program.hang_up()
        program.expect("Unloading module link")
        assert program.end() == 1  # it always exits with status 1


class Repeat:
    """Types a line repeatedly as long as it is called."""

    def __init__(self, program: Program, line: Callable[[], str], period_s: float) -> None:
        self._program, self._line, self._period_s = program, line, period_s
        self._due_s = 0.0

    def __call__(self) -> None:
        """Type the line if it is due."""
        now_s = time.monotonic()
        if now_s >= self._due_s:
            self._due_s = now_s + self._period_s
            self._program.send(self._line())


def connect(program: Program) -> None:
    program.expect("Detected vehicle 1:1 on link 0")
    found_s = time.monotonic()
    program.expect(r"Received \d+ parameters")
    assert time.monotonic() - found_s < FETCH_MAX_S


def take_off(program: Program) -> None:
    program.send("arm throttle")
    program.expect(r"Got COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    program.expect(r"\bARMED")
    program.send("takeoff 0.5")
    program.expect("Got COMMAND_ACK: NAV_TAKEOFF: ACCEPTED")
    # It prints "Mode" at most every 2 s; its prompt changes immediately.
    program.expect("Mode TAKEOFF|TAKEOFF>")
    program.expect("Mode LOITER")


def land(program: Program) -> None:
    program.send("long NAV_LAND")
    program.expect("Got COMMAND_ACK: NAV_LAND: ACCEPTED")
    program.expect("Mode LAND|LAND>")
    program.expect("DISARMED")


def test_whole_flight(tmp_path: Path, flight_number: int) -> None:
    with vehicle() as port:
        watch = Observer(port)
        with mavproxy(port, tmp_path, watch) as program:
            connect(program)
            parameters(program)
            take_off(program)
            refusals(program)
            fly(program, watch)
            land(program)
            program.until(lambda: watch.modes()[-1] == HOLD, "its end")
            typed = {shape(line) for line in program.typed}
        watch.close()
    assert documented() <= typed
    assert watch.modes() == [HOLD, TAKEOFF, HOLD, OFFBOARD, LAND, HOLD]
    assert watch.armings() == [False, True, False]
    assert max(-p.z for p in watch.all("LOCAL_POSITION_NED")) == pytest.approx(0.5, abs=0.15)
    assert watch.last("EXTENDED_SYS_STATE").landed_state == ON_GROUND
    assert -watch.last("LOCAL_POSITION_NED").z < 0.05


def shape(line: str) -> str:
    """Return a line without its numbers."""
    return re.sub(r"-?\b[\d.]+", "#", line)


def documented() -> set[str]:
    """Return the lines that the documentation asks the user to type."""
    block = re.search(r"\$ mavproxy\.py .*?\n(.*?)```", DOCUMENTATION.read_text(), re.DOTALL)
    assert block is not None
    return {shape(line) for line in block.group(1).splitlines()}


def parameters(program: Program) -> None:
    """A valid parameter is written and read back; an invalid one is rejected with a reason."""
    program.send("param set COM_OF_LOSS_T 2")  # prints nothing, and sends the value later
    read = Repeat(program, lambda: "param fetch COM_OF_LOSS_T", FETCH_S)
    program.expect(r"COM_OF_LOSS_T = 2\.0", each=read)
    program.send("param set MPC_XY_P 55")
    program.expect("AP: MPC_XY_P: 55, allowed 0.1 to 2")
    program.expect("Failed to set MPC_XY_P to 55")


def refusals(program: Program) -> None:
    """In the air disarming is rejected, and OFFBOARD without a stream."""
    program.send("disarm")
    program.expect("Got COMMAND_ACK: COMPONENT_ARM_DISARM: TEMPORARILY_REJECTED")
    program.expect("AP: Disarming refused: not landed")
    program.send("long DO_SET_MODE 157 6 0")
    program.expect("Got COMMAND_ACK: DO_SET_MODE: TEMPORARILY_REJECTED")
    program.expect("AP: Mode offboard refused: no set-points")


def fly(program: Program, watch: Observer) -> None:
    """Fly back and left by body-frame set-points: the nose points east, so west and north, off the deck."""
    velocity = (0.0, 0.0, 0.0)  # forward, right, down
    # MAVProxy sends one set-point per line.
    stream = Repeat(program, lambda: "velocity {:g} {:g} {:g}".format(*velocity), STREAM_S)
    stream()
    program.expect("x:0.0")
    program.send("long DO_SET_MODE 157 6 0")
    program.expect("Got COMMAND_ACK: DO_SET_MODE: ACCEPTED", each=stream)
    program.expect("Mode OFFBOARD", each=stream)
    for name, leg in LEGS.items():
        begin, start_m = len(watch.log), leg.way_m(watch.position)
        velocity = leg.velocity_frd_m_s
        program.until(
            lambda leg=leg, start_m=start_m: leg.way_m(watch.position) > start_m + LEG_M, name, each=stream
        )
        speeds = [leg.speed_m_s(m) for m in watch.all("LOCAL_POSITION_NED", begin)]
        print("SPEED", name, max(speeds))
        assert SPEED_M_S < max(speeds) < 1.7 * SPEED_M_S  # the paper's gains overshoot by a third
        velocity = (0.0, 0.0, 0.0)
        program.until(lambda: slow(watch.position), f"stop after {name}", each=stream)


def slow(m) -> bool:
    return m.vx**2 + m.vy**2 + m.vz**2 < 0.08**2


EXAMPLE_MAX_S = 180.0


def test_documented_example(tmp_path: Path, flight_number: int) -> None:
    block = re.search(r"^```python\n(.*?)^```", DOCUMENTATION.read_text(), re.MULTILINE | re.DOTALL)
    assert block is not None
    port_there = free_port(udp=True)
    script = tmp_path / "example.py"
    script.write_text(block.group(1).replace("0.0.0.0:14540", f"127.0.0.1:{port_there}"))
    with vehicle("--peer", f"127.0.0.1:{port_there}") as port:
        watch = Observer(port)
        with Program([sys.executable, str(script)], watch) as client:
            assert client.end(EXAMPLE_MAX_S) == 0
        watch.close()
    # A HOLD between two of them may be shorter than a tick.
    assert [mode for mode in watch.modes() if mode != HOLD] == [TAKEOFF, OFFBOARD, LAND]
    assert watch.armings() == [False, True, False]
    assert max(p.x for p in watch.all("LOCAL_POSITION_NED")) > 0.0
