"""``--quick``: a test that needs more processor time than a quick run allows is broken off and skipped.

``make quick`` runs the unit tests that are not marked ``slow``, as those of ``SLOW`` are. The bound keeps it
quick when somebody adds a slow test and forgets the marker: the reason of the skip tells to mark it.
``make test`` runs all tests whole. Processor time depends less on the load of the machine than wall time.
"""

from __future__ import annotations

import signal
from collections.abc import Generator
from pathlib import Path
from types import FrameType

import pytest
from pluggy import Result

ROOT = Path(__file__).parents[1]
CPU_MAX_S = 2.5  # s for a test, and for its fixtures
# modules and folders below tests/unit that fly many seconds, prove whole envelopes or wait for processes
SLOW = (
    "autopilot/test_fuzz_vehicle.py",
    "core/mission/test_phases.py",
    "core/target/test_target_estimator.py",
    "crazyflie/test_crazyflie_vehicle.py",
    "logs/recorder/test_recorder_process.py",
    "logs/replay/test_replay_golden.py",
    "logs/replay/test_replay_wire.py",
    "plant/test_physics.py",
    "plant/test_vehicle_docs.py",
    "plant/test_world.py",
    "validation/test_sensing_fit.py",
    "vehicle/test_landing.py",
    "vehicle/test_tired_battery.py",
    "verify/test_*.py",
)


def mark_slow(items: list[pytest.Item]) -> None:
    """Mark the tests of the slow modules."""
    slow = {path for pattern in SLOW for path in (ROOT / "tests" / "unit").glob(pattern)}
    for item in items:
        if item.path in slow:
            item.add_marker(pytest.mark.slow)


def _bounded(item: pytest.Item) -> Generator[None, Result[None], None]:
    if not item.config.getoption("--quick"):
        yield
        return
    reason = f"needs more than {CPU_MAX_S:g} s of processor time: mark it slow; `make test` runs it whole"
    over: list[int] = []

    def break_off(number: int, frame: FrameType | None) -> None:
        del frame
        over.append(number)
        pytest.skip(reason)

    previous = signal.signal(signal.SIGPROF, break_off)
    signal.setitimer(signal.ITIMER_PROF, CPU_MAX_S)
    outcome = yield
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.signal(signal.SIGPROF, previous)
    if over:  # a library that was interrupted may have raised an error of its own
        outcome.force_exception(pytest.skip.Exception(reason))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, Result[None], None]:
    """Bound the fixtures of a test."""
    yield from _bounded(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, Result[None], None]:
    """Bound a test."""
    yield from _bounded(item)
