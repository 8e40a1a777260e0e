"""px4-sim --speed 0 with a real PX4 that stands: times real time, and whose processor time limits it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from sim.plant import params
from sim.px4.airframe import parameters
from sim.px4.program import InstanceClaim, Px4Model, Px4Program
from sim.scenarios.scenario import load
from tests.px4_program import PX4_PLACE, px4_place

SCENARIO = "large"
SIMULATED_S = 60.0
WALL_MAX_S = 300.0
_TICKS_1_S = os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Processor time that a process has used, all threads, system's included."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_1_S


def _first_child(pid: int) -> int:
    """PX4 itself: the shell that waits for it is its parent."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def main() -> None:
    """Run and print."""
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
            [
                sys.executable,
                "-m",
                "flightstack.cli.main",
                *words,
                "--tcp",
                f"127.0.0.1:{px4.simulator_port}",
            ],
            stdout=subprocess.PIPE,
            text=True,
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
                    if Path(f"/proc/{pid}/cmdline").read_bytes():  # not a zombie
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


if __name__ == "__main__":
    main()
