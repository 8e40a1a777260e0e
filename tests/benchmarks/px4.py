"""Flies a real PX4 on the simulated vehicle: results of failures, and simulation speed.

The fault table is in docs/reference/results.md.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

from flightstack.common.processes import LaunchError
from flightstack.config.files import path_of
from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import InstanceClaim, Px4Model, Px4Program
from sim.scenarios.scenario import load
from tests.flight_suite.companion import Radio
from tests.integration.runs import COMMAND
from tests.px4_flight import PX4_PLACE, Px4Flying, flying, px4_place

SCENARIO = "large"
CONFIG = path_of("px4-1kg")
PHASE_MAX_S = 90.0  # time-out for the phase of the fault, stack time
DOWN_MAX_S = 180.0  # time-out for motors off after the fault, stack time
REST_M_S = 0.1  # largest vertical velocity estimated by PX4 on the ground
FLOOR_M = 0.25  # largest height on the floor (feet at 0.12 m, plus drift); on the robot it is 0.62 m

Act = Callable[[Px4Flying, Radio], None]


class Fault(NamedTuple):
    """A fault, and the phase of the flight in which it starts."""

    name: str
    phase: str
    act: Act


class Result(NamedTuple):
    place: str
    down_s: float | None  # stack time from the fault to motors off
    phases: str
    reason: str


def _sleep(one: Px4Flying, seconds: float) -> None:
    """Wait for this stack time."""
    one.until(lambda: False, seconds)


def _kill_onboard(one: Px4Flying, radio: Radio) -> None:
    assert one.onboard is not None
    one.onboard.process.kill()


def _interrupt(one: Px4Flying, radio: Radio) -> None:
    one.interrupt()


def _terminate(one: Px4Flying, radio: Radio) -> None:
    assert one.onboard is not None
    one.onboard.process.terminate()


def _kill_target(one: Px4Flying, radio: Radio) -> None:
    one.target.process.kill()


def _kill_recorder(one: Px4Flying, radio: Radio) -> None:
    one.recorder.process.kill()


def _pause(seconds: float) -> Act:
    def act(one: Px4Flying, radio: Radio) -> None:
        os.killpg(one.px4.process.pid, signal.SIGSTOP)
        _sleep(one, seconds)
        os.killpg(one.px4.process.pid, signal.SIGCONT)

    return act


def _cut(seconds: float) -> Act:
    def act(one: Px4Flying, radio: Radio) -> None:
        radio.cut()
        _sleep(one, seconds)
        radio.mend()

    return act


_KILLED_IN = ("TAKEOFF", "APPROACH", "LAND", "TOUCHDOWN")
FAULTS = [
    *(Fault("onboard process killed", phase, _kill_onboard) for phase in _KILLED_IN),
    Fault("onboard process told to end (SIGTERM)", "APPROACH", _terminate),
    Fault("Ctrl-C", "TAKEOFF", _interrupt),
    Fault("Ctrl-C", "APPROACH", _interrupt),
    Fault("target lost for good", "APPROACH", _kill_target),
    Fault("PX4 paused 1 s", "APPROACH", _pause(1.0)),
    Fault("PX4 paused 5 s", "APPROACH", _pause(5.0)),
    Fault("link cut 1 s", "APPROACH", _cut(1.0)),
    Fault("link cut 5 s", "APPROACH", _cut(5.0)),
    Fault("recorder killed", "APPROACH", _kill_recorder),
]


def fly(place: Path, fault: Fault, speed: float, folder: Path) -> Result:
    """Fly once with the fault.

    Raises LaunchError: a process did not start, or the flight did not reach the phase.
    """
    with ExitStack() as stack:
        radios: list[Radio] = []

        def by_radio(px4: Px4Program) -> str:
            radio = Radio(f"udpout:127.0.0.1:{px4.onboard_local_port}", px4.onboard_port)
            radios.append(stack.enter_context(radio))
            return radio.url

        one = stack.enter_context(flying(place, SCENARIO, CONFIG, folder, speed, by_radio))
        one.take_off()
        if not one.until(lambda: one.in_phase(fault.phase) and one.armed, PHASE_MAX_S):
            raise LaunchError(f"it did not come to {fault.phase}: {one.told[-3:]}")
        _sleep(one, 0.0 if fault.phase == "TOUCHDOWN" else 1.0)
        before = len(one.told)
        fault.act(one, radios[0])
        began_s = time.monotonic()
        down = one.until(lambda: one.disarmed, DOWN_MAX_S)
        down_s = (time.monotonic() - began_s) * speed if down else None
        one.until(one.ended, 5.0)
        after = [line.split("-> ")[1].split(":")[0] for line in one.told[before:] if "-> " in line]
        said = one.told[-1] if one.ended() and one.told[before:] else ""
        return Result(_place(one), down_s, " ".join(after), said)


def _place(one: Px4Flying) -> str:
    """Return the position, from PX4's estimate and from the simulator's contacts."""
    said = one.px4.console("listener", "vehicle_local_position", "-n", "1").splitlines()
    found = {words[0]: words[1] for words in map(str.split, said) if len(words) > 1}
    if abs(float(found["vz:"])) > REST_M_S:
        return "IN THE AIR"
    if -float(found["z:"]) < FLOOR_M:
        return "on the floor"
    touched = any(line.startswith("touched the pad") for line in one.said)
    return "on the pad" if touched else "IN THE AIR"


def faults() -> None:
    """Fly and print: [SPEED [FOLDER [WORD]]]: ratio to real time, folder of logs, part of the fault's
    name."""
    place = px4_place()
    if place is None:
        print(f"no PX4 here: {PX4_PLACE} names none; nothing flown")
        return
    given = dict(enumerate(sys.argv[1:]))
    speed, word = float(given.get(0, "1")), given.get(2, "")
    folder = Path(given[1]) if 1 in given else Path(tempfile.mkdtemp(prefix="px4-faults-"))
    print(f"logs: {folder}", flush=True)
    print("| fault | in | ends | motors off after | phases after it | said |", flush=True)
    print("|---|---|---|---|---|---|", flush=True)
    for number, fault in enumerate(FAULTS):
        if word not in fault.name:
            continue
        try:
            result = fly(place, fault, speed, folder / str(number))
        except LaunchError as error:
            print(f"| {fault.name} | {fault.phase} | not flown: {error} |", flush=True)
            continue
        print(_row(fault, result), flush=True)


def _row(fault: Fault, result: Result) -> str:
    down = f"{result.down_s:.0f} s" if result.down_s is not None else "STAYS ARMED"
    return f"| {fault.name} | {fault.phase} | {result.place} | {down} | {result.phases} | {result.reason} |"


SIMULATED_S = 60.0
WALL_MAX_S = 300.0
_TICKS_1_S = os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Return the processor time of a process, all threads, including system time."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_1_S


def _first_child(pid: int) -> int:
    """Return PX4's process; the shell that waits for it is its parent."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def speed() -> None:
    """Measure px4-sim --speed 0 with a PX4 on the ground: speed, and which process limits it."""
    place = px4_place()
    if place is None:
        print(f"no PX4 here: {PX4_PLACE} names none; nothing measured")
        return
    wanted = parameters(params.load(load(SCENARIO).vehicle.airframe))
    with tempfile.TemporaryDirectory() as folder, closing(InstanceClaim()) as claim:
        px4 = Px4Program(place, Path(folder), Px4Model.NONE_IRIS, instance=claim.number, parameters=wanted)
        words = [
            "px4-sim",
            "--scenario",
            SCENARIO,
            "--speed",
            "0",
            "--duration",
            f"{SIMULATED_S:g}",
            "--once",
        ]
        simulator = subprocess.Popen(
            [*COMMAND, *words, "--tcp", f"127.0.0.1:{px4.simulator_port}"], stdout=subprocess.PIPE, text=True
        )
        try:
            assert simulator.stdout is not None
            while "lockstep" not in simulator.stdout.readline():
                assert simulator.poll() is None, "the simulator ended"
            pids = {"px4-sim": simulator.pid, "PX4": _first_child(px4.process.pid)}
            before = {name: processor_s(pid) for name, pid in pids.items()}
            began_s = time.monotonic()
            used = dict.fromkeys(pids, 0.0)
            while simulator.poll() is None and time.monotonic() - began_s < WALL_MAX_S:
                for name, pid in pids.items():
                    if Path(f"/proc/{pid}/cmdline").read_bytes():  # ignores zombies
                        used[name] = processor_s(pid) - before[name]
                time.sleep(0.05)
            wall_s = time.monotonic() - began_s
        finally:
            simulator.kill()
            simulator.wait()
            px4.end()
    shares = ", ".join(f"{name} {1e3 * each / SIMULATED_S:.0f} ms" for name, each in used.items())
    print(
        f"{SIMULATED_S / wall_s:.1f} x real time (asked 20); processor time for a simulated second: {shares}"
    )
    print(f"with a simulator that takes no time: {SIMULATED_S / used['PX4']:.0f} x at most on one core")
