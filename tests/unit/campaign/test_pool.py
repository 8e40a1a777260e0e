"""Tests worker processes: the results of all items arrive, although items end or hang their processes."""

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


def test_an_item_that_ends_or_hangs_its_worker_costs_no_other_result():
    found = set(in_processes(work, range(8), 2, failed, limit_s=3.0))
    bad = {ENDS: "ended its worker twice", HANGS: "did not end twice"}
    assert found == {f"{item} {bad.get(item, 'done')}" for item in range(8)}


def test_processes_that_cannot_start_are_an_error():
    with pytest.raises(WorkersError, match="3 workers in a row"):
        list(in_processes(work, [1], 1, failed, start=os._exit, arguments=(1,)))
