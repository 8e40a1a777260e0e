"""Tests logs after the kill of a process, and on a full disk: readable, with few lost messages."""

from __future__ import annotations

import random
import resource
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from logs.reader.reader import LogFile
from logs.schema.schemas import CONTROLLER_STEP
from tests.integration.runs import Flying, flightstack, kill
from tests.processes.bounded import gone, wait_for

NS = 1e9
# ``WHEN_S``: range of the wall time from log size PAST_APPROACH_BYTES to the kill, s; key: whether the flight
# is in lockstep. At the kill the log is long enough for a replay, and the flight has not ended.
PAST_APPROACH_BYTES = 1_200_000  # smallest log size at the kill; the approach starts at 980,000 bytes
WHEN_S = {False: (0.7, 3.0), True: (0.3, 0.8)}
# Topic whose last message shows a victim's loss. None: any topic, because all logging ends with the victim.
OWN_TOPIC = {
    "world": "/cf1/sim/truth", "onboard-cf1": "/cf1/controller/step", "record": None, "launcher": None,
}  # fmt: skip


class FlightOverError(Exception):
    """The flight ended before the kill, because the machine was too fast."""


@dataclass(frozen=True)
class Crash:
    victim: str
    lockstep: bool
    complete: bool
    messages: int
    missing_s: float  # wall time from the last logged message of the victim to the kill


def crash(folder: Path, victim: str, seed: int, *, lockstep: bool, sooner: float = 1.0) -> Crash:
    """Fly, kill the victim after a random time multiplied by ``sooner``, and read the log."""
    wires = ["--lockstep"] if lockstep else []
    run = Flying(folder, "--scenario", "paper_moving_1", "--seed", seed, *wires)
    try:
        run.until("-> APPROACH")
        log = folder / "flight.mcap"  # on a busy machine the recorder lags behind the flight
        wait_for(lambda: log.stat().st_size > PAST_APPROACH_BYTES, "a log that grows")
        children = run.children()
        assert set(children) == {"record", "world", "onboard-cf1"}
        # the moment of the kill is random on purpose; no event is awaited here
        time.sleep(sooner * random.Random(f"{victim} {seed} {lockstep}").uniform(*WHEN_S[lockstep]))
        pid = run.process.pid if victim == "launcher" else children[victim]
        killed_s = time.time()
        if run.process.poll() is not None or run.children() != children:
            raise FlightOverError(f"{victim} had ended before the kill, seed {seed}")
        kill(pid)
        if victim == "launcher":
            run.process.wait(timeout=60.0)
            assert all(gone(child) for child in children.values()), "a process outlives the run"
        else:
            run.process.send_signal(signal.SIGINT)
            assert run.end() == 1
    finally:
        run.kill()
    return _look(folder, victim, lockstep, killed_s)


def _look(folder: Path, victim: str, lockstep: bool, killed_s: float) -> Crash:
    path = folder / "flight.mcap"
    written_s = path.stat().st_mtime
    log = LogFile(path)
    messages = list(log.messages())
    steps = [m.sequence for m in messages if m.schema == CONTROLLER_STEP]
    assert len(steps) > 10
    assert steps == list(range(steps[0], steps[0] + len(steps))), "a hole in the middle"
    replayed = flightstack("replay", path, "--check")
    assert replayed.code == 0, replayed.out + replayed.err
    topic = OWN_TOPIC[victim]
    last_s = max(m.log_time_ns for m in messages if topic in (None, m.topic)) / NS
    if lockstep:  # log times are simulated; the wall time of the last write is unknown
        missing_s = killed_s - written_s if victim == "record" else 0.0
    else:
        missing_s = max(0.0, killed_s - last_s)
    return Crash(victim, lockstep, log.complete, len(messages), missing_s)


MISSING_MAX_S = 0.5
REAL_TIME = pytest.mark.xdist_group("real-time")  # repeated after a pause of the machine
CASES = [
    pytest.param("record", False, marks=REAL_TIME),
    pytest.param("onboard-cf1", False, marks=REAL_TIME),
    pytest.param("record", True, marks=REAL_TIME),
    ("launcher", True),
]


@pytest.mark.parametrize(("victim", "lockstep"), CASES)
def test_a_kill_costs_half_a_second_of_the_log_at_most(tmp_path, victim, lockstep):
    for sooner in (1.0, 0.3, 0.0):  # on a fast machine the vehicle may land before the kill
        try:
            found = crash(tmp_path / str(sooner), victim, 1, lockstep=lockstep, sooner=sooner)
            break
        except FlightOverError as error:
            print(error)
    else:
        pytest.fail("the flight was always over before the kill")
    assert found.missing_s <= MISSING_MAX_S, found
    assert found.messages > 100
    assert found.complete == (victim != "record")  # if another process dies, the recorder closes the file


def test_a_disk_that_fills_up_in_flight_ends_the_record_and_not_the_flight(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    limits = (PAST_APPROACH_BYTES, PAST_APPROACH_BYTES)
    resource.prlimit(run.process.pid, resource.RLIMIT_FSIZE, limits)  # the children inherit the limits
    assert run.end() == 1  # status 1: the vehicle landed, but the log is incomplete
    said = "\n".join(run.lines)  # any order: a recorder on a busy machine may be seconds late
    assert "-> LANDED" in said
    assert "record ended in flight" in said or "record did not end in order" in said
    assert "writing failed (File too large)" in said
    assert "writing failed (File too large)" in (tmp_path / "record.txt").read_text()
    found = LogFile(tmp_path / "flight.mcap")
    assert 0.9 * PAST_APPROACH_BYTES < found.path.stat().st_size <= PAST_APPROACH_BYTES
    assert sum(1 for _ in found.messages()) > 100
    assert not found.complete
