"""What the tests of the recorder share: a message, and a bounded wait for another process."""

import os
import time

from flightstack.common.pacing import EPOCH_NS
from logs.schema.rows import LoopTimingRow

DEADLINE_S = 30.0  # a test that waits this long has failed


def timing(tick):
    return LoopTimingRow(EPOCH_NS + tick, tick, 0.01, 0.0, 0.0, 0.0, 0, 0).pack()


def wait_until(condition, what):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"waited {DEADLINE_S} s for {what}"
        os.sched_yield()
