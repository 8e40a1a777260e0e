"""Whichever process is killed, whenever, and on a full disk: the log stays, and what it lacks is bounded."""

from __future__ import annotations

import resource

import pytest

from logs.reader.reader import LogFile
from tests.integration.flights.crash_runs import FlightOverError, crash
from tests.integration.runs import Flying

MISSING_MAX_S = 0.5
CASES = [
    ("record", False), ("record", True), ("vehicle", False), ("onboard", False), ("target", True),
    ("launcher", True),
]  # fmt: skip


@pytest.mark.parametrize(("victim", "lockstep"), CASES)
def test_a_kill_costs_half_a_second_of_the_log_at_most(tmp_path, victim, lockstep):
    for sooner in (1.0, 0.3, 0.0):  # a quick machine has landed before the kill
        try:
            found = crash(tmp_path / str(sooner), victim, 1, lockstep=lockstep, sooner=sooner)
            break
        except FlightOverError as error:
            print(error)
    else:
        pytest.fail("the flight was always over before the kill")
    assert found.missing_s <= MISSING_MAX_S, found
    assert found.recovered == found.messages > 100
    assert found.complete == (victim != "record")  # whoever else dies, the recorder closes the file


def test_a_disk_that_fills_up_in_flight_ends_the_record_and_not_the_flight(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.wait_for("-> APPROACH")
    log = run.some_log()
    full = log.stat().st_size + 40_000  # a late recorder must not get to the end first
    resource.prlimit(run.children()["record"], resource.RLIMIT_FSIZE, (full, full))
    full = max(full, log.stat().st_size)  # what a quick recorder had written before the limit was there
    assert run.end() == 1  # landed, but the record of it is not whole
    said = "\n".join(run.lines)  # in either order: in lockstep a recorder on a busy machine is seconds behind
    assert "-> LANDED" in said
    assert "record ended in flight" in said or "record did not end in order" in said
    assert "writing failed (File too large)" in said
    assert "writing failed (File too large)" in (tmp_path / "record.txt").read_text()
    assert log.stat().st_size <= full
    found = LogFile(log)
    assert sum(1 for _ in found.messages()) > 100
    assert not found.complete
