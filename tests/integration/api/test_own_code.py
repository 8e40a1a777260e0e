"""If a user's code fails in flight, every command ends with one clear line, status 2 and a complete log."""

import sys
import textwrap

import pytest

import flightstack as fs
from flightstack.common.strict_toml import ConfigError
from tests.integration.runs import flightstack

QUICKLY = ("--lockstep", "--no-report", "--out", "run")
MANY = ("--workers", "1", "--no-report", "--out", "many")
ROBOT = "the robot's function failing.py:drive {} at t = 2.0"
FILTER = "the filter returned no velocity: failing.py:Nominal raised KeyError: 'down'"
CODE = """
import flightstack as fs

def drive(t_s, x_m, y_m, yaw_rad):
    return {} if t_s > 2.0 else (0.1, 0.0)

class Down(fs.Filter):
    def filter(self, nominal, at):
        return {{}}["down"] if at.h_m < 0.5 else at.enforced(nominal)

class Nan(fs.Filter):
    def filter(self, nominal, at):
        return at.enforced(nominal * float("nan") if at.h_m < 0.5 else nominal)

class Nominal(fs.Filter):
    def approach_m_s(self, at, over_pad):
        return {{}}["down"]
"""
SCENARIO = """
base = "lab"
name = "mine"
description = "a robot that is driven by a function"

[target]
path = "function"
function = "failing:drive"
random_speed = false
random_heading = false
"""


@pytest.fixture(autouse=True)
def forgotten(monkeypatch):
    """Remove the test's module and the module's folder from the interpreter after each test."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield
    sys.modules.pop("failing", None)


def written(folder, result):
    (folder / "failing.py").write_text(textwrap.dedent(CODE.format(result)))
    (folder / "mine.toml").write_text(SCENARIO)
    return folder


def one_line(done, text):
    assert done.code == 2
    assert text in done.err.strip().splitlines()[-1]
    assert "Traceback" not in done.err + done.out


@pytest.mark.parametrize(
    ("result", "problem"),
    [
        ("{}['lane']", "raised KeyError: 'lane'"),
        ("(float('nan'), 0.0)", "returned (nan, 0.0)"),
        ("(0.1, 0.0, 0.0)", "returned (0.1, 0.0, 0.0)"),
        ("None", "returned None"),
    ],
)
def test_a_robots_function_that_fails_is_named_by_check(tmp_path, result, problem):
    done = flightstack("check", "mine.toml", cwd=written(tmp_path, result), apart=True)
    one_line(done, ROBOT.format(problem))


def test_a_robots_function_that_fails_ends_every_flight_with_a_whole_log(tmp_path, monkeypatch):
    folder, text = written(tmp_path, "1 / 0"), ROBOT.format("raised ZeroDivisionError: division by zero")
    flown = flightstack("sitl", "--scenario", "mine.toml", *QUICKLY, cwd=folder)
    one_line(flown, text)
    assert fs.read_log(folder / "run/flight.mcap").log.t_s[-1] > 1.5
    one_line(flightstack("campaign", "mine.toml", "--runs", "2", *MANY, cwd=folder), text)
    assert (folder / "many/rows.csv").read_text().count(",error,") == 2
    monkeypatch.chdir(folder)
    with pytest.raises(ConfigError, match="raised ZeroDivisionError"):
        fs.land("mine.toml")


def test_another_method_of_a_filter_that_fails_ends_every_flight(tmp_path):
    folder, failing = written(tmp_path, "(0.1, 0.0)"), ("--filter", "failing:Nominal")
    flown = flightstack("sitl", "--scenario", "lab", *QUICKLY, *failing, cwd=folder)
    one_line(flown, FILTER)
    many = flightstack("campaign", "lab", "--runs", "1", *failing, *MANY, cwd=folder)
    one_line(many, FILTER)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("Down", "raised KeyError: 'down'"),
        (
            "Nan",
            "raised ValueError: at.enforced: found array([nan, nan, nan]); three finite numbers (m/s ENU)",
        ),
    ],
)
def test_a_filter_that_fails_aborts_every_flight(tmp_path, name, problem):
    folder, failing = written(tmp_path, "(0.1, 0.0)"), ("--filter", f"failing:{name}")
    text = f"the filter returned no velocity: failing.py:{name} {problem}"
    flown = flightstack("sitl", "--scenario", "lab", *QUICKLY, *failing, cwd=folder)
    one_line(flown, text)
    assert "aborted" in flown.out
    log = folder / "run/flight.mcap"
    unnamed = flightstack("replay", log, "--check", cwd=folder)
    assert unnamed.code == 2
    assert f"to start it, add --filter failing:{name}" in unnamed.err
    assert flightstack("replay", log, "--check", *failing, cwd=folder).code == 0
    many = flightstack("campaign", "lab", "--runs", "2", *failing, *MANY, cwd=folder)
    one_line(many, text)
