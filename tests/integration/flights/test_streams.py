"""Tests closed and full output streams: the process still does its work and returns the right exit status."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from logs.reader.flight import load_flight
from tests.golden.flights import path_of
from tests.integration.sim_processes import COMMAND

GOLDEN = str(path_of("paper_static_1"))
PRINTING = [
    ["scenarios"], ["log", "verdict", GOLDEN, "--json"],
]  # fmt: skip
SITL = ["sitl", "--scenario", "straight", "--lockstep", "--no-report", "--json"]
WALL_MAX_S = 240.0


def gone():
    """Return the writing end of a pipe whose reading end is closed."""
    reads, writes = os.pipe()
    os.close(reads)
    return writes


def ended(words, stdout):
    child = subprocess.run([*COMMAND, *words], stdout=stdout, stderr=subprocess.PIPE, timeout=WALL_MAX_S)
    return child.returncode, child.stderr.decode()


@pytest.mark.parametrize("words", PRINTING, ids=lambda words: " ".join(words[:2]))
def test_a_reader_that_has_enough_is_no_error(words):
    writes = gone()
    try:
        assert ended(words, writes) == (int("verdict" in words), "")  # ``verdict``: the log has no landing
    finally:
        os.close(writes)


def test_a_full_disk_is_told_where_the_output_is_all_there_is():
    with Path("/dev/full").open("wb") as full:
        code, said = ended(["scenarios"], full)
    assert code == 2
    assert said == "flightstack: standard output is not complete: No space left on device\n"


def shell(words, redirections, cwd):
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {redirections}', "sh", *COMMAND, *words], cwd=cwd, timeout=WALL_MAX_S,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ).returncode  # fmt: skip


@pytest.mark.parametrize("redirections", [">/dev/full 2>&- <&-", "2>&1 | true; exit 0"])
def test_a_flight_lands_and_its_log_is_whole_whatever_becomes_of_the_output(redirections, tmp_path):
    assert shell([*SITL, "--out", "flight"], redirections, tmp_path) == 0
    flight = load_flight(tmp_path / "flight" / "flight.mcap")
    assert flight.complete
    assert any("-> LANDED" in event.text for event in flight.events)


PRINTS = """
import sys, time
from flightstack.common import hangup
hangup.guard()
hangup.never_wait()
for _ in range(20):
    print("x" * 100_000, flush=True)
print("y" * 100_000, file=sys.stderr, flush=True)
"""


def test_a_reader_that_does_not_read_is_not_waited_for_in_a_flight():
    reads, writes = os.pipe()
    try:
        began_s = time.monotonic()
        child = subprocess.run([sys.executable, "-c", PRINTS], stdout=writes, stderr=writes, timeout=60.0)
        assert child.returncode == 0
        assert time.monotonic() - began_s < 30.0
        assert len(os.read(reads, 1 << 20)) > 1000  # the pipe is full
    finally:
        os.close(reads)
        os.close(writes)
