"""``sitl`` with another autopilot: a real PX4 where there is one, a stand-in for ArduPilot's program."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from flightstack.common.strict_toml import dumps
from logs.reader.flight import load_flight
from sim.scenarios.scenario import PathKind, load
from tests.integration.flights.test_sitl import KEYS
from tests.integration.runs import called, flightstack
from tests.px4_program import px4_or_skip

pytestmark = pytest.mark.xdist_group("real-time")

STAND_IN = Path(__file__).parents[2] / "ardupilot_stand_in.py"
ORIGIN_WGS84 = (47.397742, 8.545594, 10.0)


def test_one_command_lands_a_real_px4_and_its_log_knows_the_truth(tmp_path):
    px4 = px4_or_skip()
    words = ("--scenario", "large", "--px4", px4, "--seed", 1, "--no-report", "--json")
    done = flightstack("sitl", *words, "--out", tmp_path / "run")
    assert done.code == 0, done.out + done.err
    found = done.json
    assert set(found) >= KEYS
    assert (found["outcome"], found["judged_from"]) == ("landed", "truth")
    assert found["touchdown_error_m"] < 0.3
    flight = load_flight(found["log"])
    assert flight.metadata["run"]["vehicle"] == "px4"
    assert "scenario.toml" in flight.attachments


def test_arducopters_program_is_started_and_flown_over_tcp(tmp_path):
    scenario = load("grid")
    there = replace(scenario.onboard.vehicle, origin_wgs84=ORIGIN_WGS84)
    config, still = tmp_path / "config.toml", tmp_path / "still.toml"
    checks = replace(scenario.onboard.checks, wait_time_max_s=150.0)  # a busy machine starts slowly
    config.write_text(dumps(replace(scenario.onboard, vehicle=there, checks=checks)))
    target = replace(scenario.target, path=PathKind.STILL, speed_m_s=0.0)
    still.write_text(dumps(replace(scenario, name="still", target=target)))
    program = tmp_path / "arducopter"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {STAND_IN} "$@"\n')
    program.chmod(0o755)
    done = flightstack(
        "sitl", "--scenario", still, "--ardupilot", program, "--config", config,
        "--instance", os.getpid() % 10, "--no-report", "--json", "--out", tmp_path / "run",
    )  # fmt: skip
    assert done.code == 0, done.out + done.err
    assert set(done.json) >= KEYS
    assert (done.json["outcome"], done.json["judged_from"]) == ("landed", "estimate")
    defaults = (tmp_path / "run" / "ardupilot" / "defaults.parm").read_text()
    assert "GUID_TIMEOUT 0.5\n" in defaults


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--px4", "{program}", "--lockstep"), "--lockstep with --px4"),
        (("--px4", "{program}", "--ardupilot", "{program}"), "only one of"),
        (("--speed", "2"), "--lockstep is faster"),
        (("--ardupilot", "{program}", "--mocap"), "instead of satellites"),
        (("--px4", "{program}"), "is not beside it"),
    ],
)
def test_what_does_not_go_together_is_refused(tmp_path, words, said):
    program = tmp_path / "px4"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    filled = [word.format(program=program) for word in words]
    done = called("sitl", "--scenario", "grid", *filled, "--config", "crazyflie", "--out", tmp_path / "run")
    assert done.code == 2, done.out + done.err
    assert said in done.err


def test_several_runs_are_summed_up(tmp_path):
    done = flightstack(
        "sitl", "--scenario", "paper_static_2", "--lockstep", "--runs", 2, "--seed", 3, "--no-report",
        "--json", "--out", tmp_path,
    )  # fmt: skip
    assert done.code == 0, done.out + done.err
    found = done.json
    assert (found["runs"], found["flown"], found["landed"], found["violations"]) == (2, 2, 2, 0)
    assert [row["seed"] for row in found["rows"]] == [3, 4]
    errors = sorted(row["touchdown_error_m"] for row in found["rows"])
    assert found["touchdown_error_m"] == pytest.approx(sum(errors) / 2)
    assert found["touchdown_error_max_m"] == errors[1]
    assert (tmp_path / "seed4" / "flight.mcap").exists()
