"""Flies the real PX4 program on the simulated vehicle, with one fault in each flight.

``python -m tests.benchmarks px4_faults [WORD]``: only faults whose name contains WORD. The table is in
docs/reference/results.md.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from flightstack.common.processes import Child, LaunchError
from flightstack.config.files import path_of
from tests.flight_suite.companion import Companion, Radio, companion
from tests.flight_suite.room import Room, on_px4
from tests.processes.started import StartedChild
from tests.px4_place import PX4_PLACE, px4_place

SCENARIO = "large"
PHASE_MAX_S = 90.0  # time-out until the phase of the fault begins, s
DOWN_MAX_S = 180.0  # time-out from the fault to motors off, s
REST_M_S = 0.1  # estimated vertical speed up to which a vehicle counts as on the ground, m/s
FLOOR_M = 0.25  # maximum estimated height on the floor, m: 0.12 m plus drift; on the robot it is 0.62 m
LOOK_S = 0.02


class Flying(NamedTuple):
    """Parts of a running flight that the functions of the faults can change."""

    room: Room
    onboard: Companion
    radio: Radio
    recorder: Child


Act = Callable[[Flying], None]


def _signal(number: signal.Signals) -> Act:
    return lambda one: one.onboard.signal(number)


def _pause(seconds: float) -> Act:
    def act(one: Flying) -> None:
        group = one.room.px4.process.pid
        os.killpg(group, signal.SIGSTOP)
        time.sleep(seconds)
        os.killpg(group, signal.SIGCONT)

    return act


def _cut(seconds: float) -> Act:
    def act(one: Flying) -> None:
        one.radio.cut()
        time.sleep(seconds)
        one.radio.mend()

    return act


FAULTS: list[tuple[str, str, Act]] = [  # name of the fault, phase in which it starts, function
    *(
        ("onboard process killed", phase, _signal(signal.SIGKILL))
        for phase in ("TAKEOFF", "APPROACH", "LAND", "TOUCHDOWN")
    ),
    ("SIGTERM to the onboard process", "APPROACH", _signal(signal.SIGTERM)),
    ("Ctrl-C", "TAKEOFF", _signal(signal.SIGINT)),
    ("Ctrl-C", "APPROACH", _signal(signal.SIGINT)),
    ("target lost permanently", "APPROACH", lambda one: one.room.target.process.kill()),
    ("PX4 paused 1 s", "APPROACH", _pause(1.0)),
    ("PX4 paused 5 s", "APPROACH", _pause(5.0)),
    ("link cut 1 s", "APPROACH", _cut(1.0)),
    ("link cut 5 s", "APPROACH", _cut(5.0)),
    ("recorder killed", "APPROACH", lambda one: one.recorder.process.kill()),
]


def fly(place: Path, phase: str, act: Act, folder: Path) -> str:
    """Fly with a fault; return table cells: where the vehicle ended, time to motors off, later phases.

    Raises LaunchError or AssertionError: a process did not start, or the flight did not reach the phase.
    """
    folder.mkdir()
    socket = folder / "feed"
    with ExitStack() as stack:
        words = [
            "record",
            "--socket",
            str(socket),
            "--out",
            str(folder / "flight.mcap"),
            "--until-clients",
            "2",
        ]
        recorder = StartedChild("record", words, folder)
        stack.callback(recorder.end, 30.0)
        recorder.wait_ready()
        room = stack.enter_context(on_px4(folder, place, SCENARIO, 1, recorder=socket))
        # PX4's local port is 14,580 plus the instance number, which is the system id minus 1
        radio = stack.enter_context(
            Radio(f"udpout:127.0.0.1:{14_579 + room.system_id}", int(room.url.rpartition(":")[2]))
        )
        flown = replace(room, url=radio.url, config=path_of("px4-1kg"), recorder=socket)
        onboard = stack.enter_context(companion(flown))
        onboard.until(f"-> {phase}", PHASE_MAX_S)
        time.sleep(0.0 if phase == "TOUCHDOWN" else 1.0)
        said = room.vehicle.lines(0.0)
        before, began_s = len(onboard.said), time.monotonic()
        act(Flying(room, onboard, radio, recorder))
        while [line for line in said if line in ("armed", "disarmed")][-1:] != ["disarmed"]:
            if time.monotonic() - began_s > DOWN_MAX_S:
                return "| STAYS ARMED | | |"
            said += room.vehicle.lines(LOOK_S)
            onboard.said += onboard.child.lines(0.0)
        down_s = time.monotonic() - began_s
        after = [line.split("-> ")[1].split(":")[0] for line in onboard.said[before:] if "-> " in line]
        return f"| {_place(room, said)} | {down_s:.0f} s | {' '.join(after)} |"


def _place(room: Room, said: list[str]) -> str:
    """Return the vehicle's place (air, floor or pad), from PX4's estimate and the simulator's contacts."""
    listed = room.px4.console("listener", "vehicle_local_position", "-n", "1").splitlines()
    found = {words[0]: words[1] for words in map(str.split, listed) if len(words) > 1}
    if abs(float(found["vz:"])) > REST_M_S:
        return "IN THE AIR"
    if -float(found["z:"]) < FLOOR_M:
        return "on the floor"
    return "on the pad" if any(line.startswith("touched the pad") for line in said) else "IN THE AIR"


def main() -> None:
    place = px4_place()
    if place is None:
        sys.exit(f"no PX4 here: {PX4_PLACE} names none; nothing flown")
    folder = Path(tempfile.mkdtemp(prefix="px4-faults-"))
    print(f"logs: {folder}", flush=True)
    for number, (name, phase, act) in enumerate(FAULTS):
        if not sys.argv[1:] or sys.argv[1] in name:
            try:
                result = fly(place, phase, act, folder / str(number))
            except (LaunchError, AssertionError) as error:
                result = f"| not flown: {error} | | |"
            print(f"| {name} | {phase} {result}", flush=True)
