"""What ``fly`` hands on to the onboard process, and how many runs are summed up."""

from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from flightstack.cli.main import main
from flightstack.common.processes import LaunchError
from flightstack.config.files import load
from flightstack.launch import fly
from flightstack.launch.launcher import words
from flightstack.launch.run_options import Flies, RunOptions
from flightstack.launch.sitl import prepare, sum_up
from sim.scenarios.scenario import load as load_scenario


@pytest.fixture
def asked(monkeypatch):
    """``asked(*words)``: the configuration and options that reach the flight, and the exit status."""
    seen = []

    def run(config, options, console):
        seen.append((config, options))
        raise LaunchError("not flown here", 2)

    monkeypatch.setattr(fly, "run", run)

    def ask(*words):
        done = CliRunner().invoke(main, ["fly", *map(str, words)])
        return (*seen[-1], done.exit_code) if seen else done

    return ask


def test_every_option_of_the_onboard_process_is_handed_on_as_it_was_given(asked, tmp_path):
    key, zenoh = tmp_path / "vehicle.key", tmp_path / "zenoh.json5"
    zenoh.write_text("{}")
    config, options, status = asked(
        "--vehicle", "udpin:0.0.0.0:14540", "--target", "ros2:/pose", "--config", "crazyflie",
        "--connect", "tcp/10.0.0.2:7447", "--connect", "tcp/10.0.0.3:7447", "--listen", "tcp/0.0.0.0:7448",
        "--autopilot", "ardupilot", "--signing-key", key, "--allow-unsigned", "--system-id", 7,
        "--target-type", "pose", "--target-offset", 0.1, -0.2, 0.3, "--ros2", "tcp/127.0.0.1:7447",
        "--ros-domain", 5, "--zenoh-config", zenoh, "--duration", 30, "--namespace", "cf2", "--out", tmp_path,
    )  # fmt: skip
    assert config == load("crazyflie")
    given = list(options.words)
    pairs = set(pairwise(given))
    assert pairs >= {
        ("--vehicle", "udpin:0.0.0.0:14540"), ("--target", "ros2:/pose"), ("--target-type", "pose"),
        ("--connect", "tcp/10.0.0.2:7447"), ("--connect", "tcp/10.0.0.3:7447"),
        ("--listen", "tcp/0.0.0.0:7448"), ("--autopilot", "ardupilot"), ("--signing-key", str(key)),
        ("--system-id", "7"), ("--ros2", "tcp/127.0.0.1:7447"), ("--ros-domain", "5"),
        ("--zenoh-config", str(zenoh)), ("--duration", "30.0"), ("--namespace", "cf2"),
    }  # fmt: skip
    at = given.index("--target-offset")
    assert given[at + 1 : at + 4] == ["0.1", "-0.2", "0.3"]
    assert "--allow-unsigned" in given
    assert not {"--config", "--out", "--no-record", "--json", "--report"} & set(given)
    assert (options.record, options.out) == (True, tmp_path)
    assert (options.name, options.namespace) == ("crazyflie", "cf2")
    assert status == 2  # the child's reason for not starting


def test_what_was_not_given_is_not_handed_on_and_recording_is_declined_by_its_option_alone(asked):
    _, options, _ = asked(
        "--vehicle", "udpin:127.0.0.1:14540", "--config", "sitl-1kg", "--no-record", "--json"
    )
    assert not {"--allow-unsigned", "--signing-key", "--ros2", "--duration"} & set(options.words)
    assert (options.record, options.live) == (False, False)


def test_options_are_written_as_words_of_a_command_line():
    assert words(px4_sih=Path("px4"), lockstep=True, once=False, clock=None, listen=["a", "b"]) == [
        "--px4-sih", "px4", "--lockstep", "--listen", "a", "--listen", "b",
    ]  # fmt: skip
    assert words(target_offset=(0, 0, -0.2)) == ["--target-offset", "0", "0", "-0.2"]


def test_runs_are_counted_and_what_did_not_fly_is_no_landing():
    rows = [
        {"outcome": "landed", "landed": True, "violation": False, "touchdown_error_m": 0.02},
        # a log not whole
        {"outcome": "landed", "landed": False, "violation": True, "touchdown_error_m": 0.06},
        {"outcome": "crashed", "landed": False, "violation": None, "touchdown_error_m": None},
        {"outcome": None, "problem": "px4 did not start"},
    ]
    found = sum_up(rows, 5)
    assert (found["runs"], found["flown"], found["landed"], found["crashed"]) == (5, 4, 1, 1)
    assert (found["aborted"], found["violations"]) == (0, 1)
    assert found["touchdown_error_m"] == pytest.approx(0.04)
    assert found["touchdown_error_max_m"] == 0.06
    assert found["time_to_land_s"] is None
    assert found["rows"] == rows


@pytest.mark.parametrize(("scenario", "config"), [("grid", "px4-crazyflie"), ("large", "px4-1kg")])
def test_a_configuration_that_does_not_say_where_to_begin_begins_where_the_scenario_does(scenario, config):
    given = load_scenario(scenario).onboard.takeoff.start_offset_m
    assert load(config).takeoff.start_offset_m is None
    flown = prepare(RunOptions(scenario, flies=Flies.PX4)).onboard
    assert flown.takeoff.start_offset_m == given
    assert flown.vehicle == load(config).vehicle


def test_a_configuration_that_says_where_to_begin_is_flown_as_it_is():
    flown = prepare(RunOptions("grid", config="crazyflie")).onboard
    assert flown == load("crazyflie")
