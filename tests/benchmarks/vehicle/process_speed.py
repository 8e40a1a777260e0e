"""The real vehicle process in lockstep against a minimal companion: processor time per simulated second.

Twice: with a companion that answers some ticks ahead, so that the vehicle never waits, and in turns, as a
real companion has to.
"""

from __future__ import annotations

import select
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mav

from bridge.mavlink.codec.decoding import decode
from bridge.mavlink.codec.framing import split_frames

RATE_HZ = 100
ASKED = 100.0
AHEAD_TICKS = 8
SETTLE_TICKS, TICKS = 400, 3000
SEEDS = range(3)
PATIENCE_S = 90.0  # compiling included
NAN = float("nan")
ROOT = Path(__file__).parents[3]


def heartbeat():
    """What a companion says of itself."""
    return mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)


def command(number: int, *params: float):
    """One command to the vehicle."""
    return mav.MAVLink_command_long_message(1, 1, number, 0, *params, *[NAN] * (7 - len(params)))


def plan(tick: int, flying: bool) -> list:
    """A velocity that changes direction every second; arm, take-off and OFFBOARD at their ticks to fly."""
    speed = 0.2 if tick // RATE_HZ % 2 else -0.2
    zeros = (0.0, 0.0, 0.0)
    setpoint = mav.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 2503, *zeros, speed, 0.0, 0.0, *zeros, 1.5708, 0.0
    )
    commands = {5: (400, 1.0), 8: (22,), 350: (176, 1.0, 6.0)} if flying else {}
    return [command(*commands[tick]), setpoint] if tick in commands else [setpoint]


class Companion:
    """Answers every tick, ``ahead`` ticks before it is asked."""

    def __init__(self, url: str, flying: bool, ahead: int) -> None:
        _, host, port = url.split(":")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((host, int(port)))
        self._mav = mav.MAVLink(None, 1, 191)
        self._flying, self._ahead = flying, ahead
        self._answered = -1
        self._send([heartbeat()])

    def _send(self, messages: list) -> None:
        data = b""
        for message in messages:
            data += message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
        self._socket.send(data)

    def run(self, last_tick: int) -> None:
        """Go on until the vehicle has asked for this tick."""
        asked = -1
        while asked < last_tick:
            assert select.select([self._socket], [], [], PATIENCE_S)[0], "the vehicle fell silent"
            *_, frame = split_frames(self._socket.recv(65536))
            message = decode(frame)
            if message.get_msgId() != mav.MAVLINK_MSG_ID_TIMESYNC:
                continue
            asked = max(asked, message.ts1 * RATE_HZ // 1_000_000_000)
            while self._answered < asked + self._ahead:
                self._answered += 1
                ns = self._answered * 1_000_000_000 // RATE_HZ
                answer = mav.MAVLink_timesync_message(ns + 1, ns)
                self._send([*plan(self._answered, self._flying), answer])


def processor_s(pid: int) -> float:
    """Processor time of a process, all threads (Linux, sched-stats)."""
    tasks = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9


@contextmanager
def vehicle_process(seed: int) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command as a user starts it, and its URL."""
    words = f"vehicle --scenario paper_moving_1 --url udpin:127.0.0.1:0 --lockstep --seed {seed}"
    child = subprocess.Popen(
        [sys.executable, "-m", "flightstack.cli.main", *words.split()],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert child.stdout is not None
        assert select.select([child.stdout], [], [], PATIENCE_S)[0], "no ready line"
        yield child, child.stdout.readline().strip().removeprefix("ready ")
    finally:
        child.terminate()
        child.wait(PATIENCE_S)


def factors(seed: int, flying: bool, ahead: int) -> tuple[float, float]:
    """Simulated time over processor time, and over wall time, after settling."""
    with vehicle_process(seed) as (child, url):
        companion = Companion(url, flying, ahead)
        companion.run(SETTLE_TICKS)
        start_s, wall_s = processor_s(child.pid), time.monotonic()
        companion.run(SETTLE_TICKS + TICKS)
        used_s, wall_s = processor_s(child.pid) - start_s, time.monotonic() - wall_s
    return TICKS / RATE_HZ / used_s, TICKS / RATE_HZ / wall_s


def main() -> None:
    """Run and print."""
    for flying in (True, False):
        for ahead, how in ((AHEAD_TICKS, "never waiting"), (0, "in turns")):
            found = [factors(seed, flying, ahead) for seed in SEEDS]
            processor, wall = (statistics.median(values) for values in zip(*found, strict=True))
            each = ", ".join(f"{used:.0f}" for used, _ in found)
            state = "flying" if flying else "standing"
            print(
                f"process, {state}, {how}: {processor:.0f} x real time of processor time (asked {ASKED:.0f}; "
                f"seeds {each}), {wall:.0f} x of wall time"
            )


if __name__ == "__main__":
    main()
