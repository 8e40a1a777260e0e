"""Tests worker processes: all results arrive, even if an item ends or blocks a process."""

import os
import time

import pytest

from flightstack.common.pool import WorkersError, in_processes

ENDS, HANGS = 3, 5


def work(item: int) -> str:
    if item == ENDS:
        os._exit(7)
    if item == HANGS:
        time.sleep(100.0)
    return f"{item} done"


def failed(item: int, why: str) -> str:
    return f"{item} {why}"


def test_an_item_that_ends_its_worker_costs_no_other_result():
    found = set(in_processes(work, range(5), 2, failed))
    assert found == {f"{item} {'ended its worker twice' if item == ENDS else 'done'}" for item in range(5)}


def test_an_item_that_does_not_end_is_given_up():
    assert list(in_processes(work, [HANGS], 1, failed, limit_s=1.0)) == [f"{HANGS} did not end twice"]


def test_processes_that_cannot_start_are_an_error():
    with pytest.raises(WorkersError, match="a worker ended before it was ready"):
        list(in_processes(work, [1], 1, failed, start=os._exit, arguments=(1,)))


def test_without_shared_memory_the_work_is_done_in_this_process(monkeypatch, capsys):
    def no_lock():
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr("multiprocessing.Lock", no_lock)
    assert list(in_processes(lambda item: (item, os.getpid()), range(2), 2, failed)) == [
        (0, os.getpid()),
        (1, os.getpid()),
    ]
    assert "one process instead of 2: no shared memory" in capsys.readouterr().err
