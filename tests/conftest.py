"""Defines the command line options and the collection rules of the tests."""

from __future__ import annotations

import gc
import itertools
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

from bridge.mavlink.profiles import AUTO, CHOICES
from flightstack.config import path_of
from tests.examples import QUICK
from tests.real_time import in_real_time, repeated_after_a_pause
from tests.real_time import pytest_runtest_setup as pytest_runtest_setup

# number of workers that fly in real time; three run on two cores, because other workers have lower priority
STREAMS = int(os.environ.get("FLIGHTSTACK_TEST_STREAMS", "3"))
STREAM_NAMES = [f"stream {number}" for number in range(STREAMS)]  # "stream 0" flies the real PX4

# set before numpy is loaded: threads of its matrix functions would only compete with the other workers
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# In background jobs of a shell, SIGINT is ignored; the processes of the tests would inherit this.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup makes processes ignore SIGHUP

# No deadline, because a busy machine must not cause failures; the same examples in each run. New examples:
# pytest --hypothesis-profile="new examples"
hypothesis.settings.register_profile("new examples", deadline=None)
hypothesis.settings.register_profile("same examples", deadline=None, derandomize=True)
hypothesis.settings.register_profile(QUICK, deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.load_profile("same examples")


STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


@pytest.fixture(autouse=True)
def process_as_before() -> Iterator[None]:
    """Undo a test's changes to the worker's process, because later tests run in this process in any order."""
    variables, folder, path = dict(os.environ), Path.cwd(), list(sys.path)
    handlers = [(number, signal.getsignal(number)) for number in STOPS]
    yield
    for name in os.environ.keys() - variables.keys():
        del os.environ[name]
    os.environ.update(variables)
    os.chdir(folder)
    sys.path[:] = path
    for number, handler in handlers:
        if handler is not None:  # None: installed by C code, so Python cannot install it again
            signal.signal(number, handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    add = parser.addoption
    add("--flights", type=int, default=1, metavar="N", help="fly each flight of a real client N times")
    add("--vehicle", metavar="URL", help="fly this vehicle and no other: only the tests that can are run")
    add("--px4", type=Path, metavar="PLACE", help="fly this PX4 SITL, by px4-sim, and no other vehicle")
    add("--scenario", default="large", metavar="NAME_OR_FILE", help="scenario of --px4")
    add("--speed", type=float, default=1.0, metavar="X", help="speed of --px4 against real time")
    add("--target", default="cf1/target/odom", metavar="KEY", help="Zenoh key of its target's odometry")
    add(
        "--target-offset", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("X", "Y", "Z"),
        help="landing spot from the target's tracked frame, in that frame's axes, m: forward, left, up",
    )  # fmt: skip
    add("--connect", action="append", default=[], metavar="ENDPOINT", help="Zenoh endpoint of the target")
    add("--listen", metavar="ENDPOINT", help="Zenoh endpoint of the onboard process")
    add("--config", type=path_of, metavar="NAME_OR_FILE", help="configuration of the onboard process")
    add("--autopilot", default=AUTO, choices=CHOICES, help="profile of the vehicle; auto: by its heartbeat")
    add("--system-id", type=int, default=1, metavar="N", help="of the vehicle")
    add("--signing-key", type=Path, metavar="FILE", help="sign MAVLink with it")
    add("--takeoff-height", type=float, default=0.5, metavar="M", help="height of the steps without a target")
    add(
        "--fence", type=float, nargs=2, default=(2.0, 4.0), metavar=("HEIGHT_M", "DISTANCE_M"),
        help="a step beyond it ends, and the vehicle is brought down",
    )  # fmt: skip
    add("--arm-ok", action="store_true", help="the vehicle given may arm and fly: somebody watches it")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "slow: not run by `make quick`")
    config.addinivalue_line("markers", "flaky: repeated by pytest-rerunfailures, where that is installed")
    config.addinivalue_line("markers", "vehicle: flies our simulated vehicle, or the one of --vehicle")
    config.addinivalue_line("markers", "given: only run on a given vehicle")
    config.addinivalue_line("markers", "arms: not run on a vehicle that was given without --arm-ok")
    config.addinivalue_line("markers", "simulated: needs the simulated room")
    config.addinivalue_line("markers", "xdist_group(name): run by one worker, also where there is no xdist")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Use one worker per core; ``-n auto`` adds the streams of flights, because flights mostly wait."""
    more = 0 if config.option.numprocesses == "logical" else STREAMS
    return more + (os.cpu_count() or 1)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Keep garbage collections rare and short; by default collections take a seventh of the time."""
    gc.disable()
    done = yield
    gc.freeze()  # later collections skip all modules and tests that are loaded
    gc.set_threshold(20_000, 20, 50)
    gc.enable()
    return done


@pytest.hookimpl(tryfirst=True)  # runs before pytest-xdist reads the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With ``--vehicle`` or ``--px4``, run only tests for any vehicle; tests that arm need ``--arm-ok``."""
    px4 = config.getoption("--px4") is not None
    if config.getoption("--vehicle") is None and not px4:
        if config.getoption("--flights") == 1:  # above 1: only named tests run, in one process
            items[:] = [item for item in items if not _marked(item, "given")]
            _deal_out(items)
        return
    arm_ok = px4 or config.getoption("--arm-ok")

    def runs(item: pytest.Item) -> bool:
        flies = _marked(item, "vehicle") and not _marked(item, "simulated")
        return flies and (arm_ok or not _marked(item, "arms"))

    left_out = [item for item in items if not runs(item)]
    items[:] = [item for item in items if runs(item)]
    config.hook.pytest_deselected(items=left_out)


def _deal_out(items: list[pytest.Item]) -> None:
    """Assign each real-time flight to a stream (a worker); a test can name its stream."""
    turn = itertools.cycle(STREAM_NAMES)
    for item in items:
        if _marked(item, "vehicle"):
            item.add_marker(pytest.mark.xdist_group("real-time"))
        if in_real_time(item):
            item.add_marker(repeated_after_a_pause())
            if not any(name in mark.args for mark in item.iter_markers() for name in STREAM_NAMES):
                item.add_marker(pytest.mark.xdist_group(next(turn)))


def _marked(item: pytest.Item, name: str) -> bool:
    """Whether a test has this marker; ``keywords`` also contains parameter values, so it cannot be used."""
    return item.get_closest_marker(name) is not None


def pytest_make_parametrize_id(config: pytest.Config, val: object) -> str | None:
    """Name a frame or payload by its length, because the bytes are unreadable."""
    del config
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test that has the argument ``flight_number`` ``--flights`` times."""
    config = metafunc.config
    if "flight_number" in metafunc.fixturenames:
        metafunc.parametrize("flight_number", range(config.getoption("--flights")))
