"""Which tests fly a vehicle that is given by ``--vehicle``, and what the suite hands on of its options."""

import argparse
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

from flightstack.cli.fly.onboard import onboard
from sim.scenarios.scenario import load
from tests.conftest import pytest_addoption
from tests.flight_suite.companion import onboard_words
from tests.flight_suite.room import configured, given
from tests.integration.runs import WALL_MAX_S
from tests.integration.sim_processes import ROOT

HERE = Path(__file__).parent
# its own tests, others that fly, and one whose parameter is the word "vehicle"
FILES = [HERE / "test_any_vehicle.py", HERE / "test_mavsdk.py", HERE.parent / "flights" / "test_cli.py"]
GIVEN = ["--vehicle", "udpin:127.0.0.1:0", "--config", "crazyflie"]


def collected(*more):
    """Names of the tests that are left on a vehicle that is given."""
    words = ["-q", "-n", "0", "-p", "no:cacheprovider", "--collect-only", *FILES, *GIVEN, *more]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *map(str, words)],
        cwd=ROOT, capture_output=True, text=True, timeout=WALL_MAX_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return [line for line in done.stdout.splitlines() if "::" in line]


def test_without_leave_only_what_looks_is_run():
    names = [name.split("::")[1] for name in collected()]
    assert names == [
        "test_connects_and_tells_who_and_where_it_is[0-auto]",
        "test_its_parameters_are_safe[0-auto]",
    ]


def test_with_leave_all_steps_fly_and_nothing_else():
    names = collected("--arm-ok")
    assert len(names) == 12
    assert all("test_any_vehicle.py::" in name for name in names)
    assert not any("silent_is_left_alone" in name for name in names)


class Options:
    """The suite's own options of a command line."""

    def __init__(self, *words):
        parser = argparse.ArgumentParser()
        pytest_addoption(SimpleNamespace(addoption=parser.add_argument))
        self._given = parser.parse_args([str(word) for word in words])

    def getoption(self, name):
        return getattr(self._given, name.removeprefix("--").replace("-", "_"))


def test_the_options_reach_the_onboard_process(tmp_path):
    where = ["--vehicle", "serial:/dev/ttyACM0:921600", "--config", configured(load("grid"), tmp_path)]
    options = Options(*where, "--target-offset", "-0.032", "0", "0.2", "--system-id", "7")
    with given(options, tmp_path) as room:
        verb, *words = onboard_words(room)
    params = onboard.make_context(verb, words).params
    assert params["target_offset_m"] == (-0.032, 0.0, 0.2)
    assert params["autopilot"] == "auto"
    assert params["system_id"] == 7
    assert params["vehicle_url"] == "serial:/dev/ttyACM0:921600"
