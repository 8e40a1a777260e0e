"""Whole runs over the real wires, in lockstep."""

import re
import signal

import pytest

from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from tests.integration.runs import Flying, flightstack, fly, gone, kill, replayed

PAPER = ["paper_static_1", "paper_static_2", "paper_moving_1", "paper_moving_2"]
FILTERS = {"paper": (), "robust": ("--filter", "robust")}  # the first is what these scenarios ask for
KEYS = {
    "scenario", "seed", "filter", "outcome", "violation", "h_min_m", "h_min_outside_pad_m",
    "touchdown_error_m", "touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s", "time_to_land_s",
    "realtime_factor", "log", "report",
}  # fmt: skip


def assert_decided_again(log):
    found = replayed(log)
    assert found["phases_recorded"][-1]["phase"] == "LANDED"
    assert found["compared"] > 500


@pytest.mark.parametrize("filter_name", FILTERS)
@pytest.mark.parametrize("scenario", PAPER)
def test_the_papers_runs_land_and_replay_bit_by_bit(flown, scenario, filter_name):
    result = flown(scenario, 0, *FILTERS[filter_name])
    assert result.code == 0, result.err
    found = result.json
    assert set(found) >= KEYS
    assert (found["scenario"], found["seed"], found["filter"]) == (scenario, 0, filter_name)
    assert found["outcome"] == "landed"
    assert found["judged_from"] == "truth"
    assert found["touchdown_error_m"] <= 0.10
    assert -0.2 < found["h_min_outside_pad_m"] < 1.0
    assert_decided_again(result.log)


@pytest.mark.parametrize("scenario", ["straight", "stop_and_go", "reversing"])
def test_other_paths_loops_and_a_start_in_hover_land_by_contact_and_replay(tmp_path, scenario):
    result = fly(tmp_path, scenario)
    assert result.code == 0, result.err
    assert result.json["outcome"] == "landed"
    assert result.json["touchdown_error_m"] <= 0.10
    assert result.json["touchdown_speed_vertical_m_s"] < 0.35  # set down; a fall from 5 cm ends with 0.75 m/s
    assert_decided_again(tmp_path / "flight.mcap")


def test_the_same_seed_makes_the_same_log_and_another_one_flown_beside_it_does_not(flown, tmp_path):
    first = flown("paper_moving_2", 0)
    flying = [
        Flying(tmp_path / str(k), "--scenario", "paper_moving_2", "--lockstep", "--seed", k) for k in (0, 1)
    ]
    assert [run.end() for run in flying] == [0, 0], [run.lines for run in flying]
    same = flightstack("compare", first.log, tmp_path / "0" / "flight.mcap")
    assert (same.code, same.out.strip().splitlines()[-1]) == (0, "equal"), same.out
    other = flightstack("compare", first.log, tmp_path / "1" / "flight.mcap")
    assert other.code == 1
    assert "/cf1/" in other.out


@pytest.mark.parametrize("wires", [["--lockstep"], []])
def test_an_interrupted_run_ends_everything_and_says_what_was_reached(tmp_path, wires):
    run = Flying(tmp_path, "--scenario", "paper_static_2", *wires)
    run.wait_for("-> TAKEOFF")
    children = run.children()
    assert set(children) == {"record", "target", "vehicle", "onboard"}
    run.process.send_signal(signal.SIGINT)
    assert run.end() == 1
    # aborted once it is armed, for then the vehicle is told to land before the process ends
    assert any(re.search(r"outcome\W+(aborted|timeout)", line) for line in run.lines), run.lines
    assert all(gone(pid) for pid in children.values())
    flight = load_flight(tmp_path / "flight.mcap")
    assert flight.complete
    assert len(flight.steps.tick) > 0


def test_a_killed_onboard_process_leaves_a_vehicle_that_lands_itself(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_1", "--lockstep")  # begins well away from the robot
    run.wait_for("-> APPROACH")
    kill(run.children()["onboard"])
    assert run.end() == 1
    truth = load_flight(tmp_path / "flight.mcap").truth
    assert not truth.motors_running[-1]
    speeds = (truth.velocity_enu_m_s**2).sum(axis=1) ** 0.5
    assert speeds[-1] < 0.05
    assert speeds.max() < 1.0  # it came down under power; a fall from there ends with 4 m/s
    assert truth.position_enu_m[-1, 2] < 0.25


def test_a_killed_target_is_held_climbed_from_and_landed_away_from(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_moving_1", "--lockstep")
    run.wait_for("-> APPROACH")
    kill(run.children()["target"])
    assert run.end() == 1
    flight = load_flight(tmp_path / "flight.mcap")
    phases = set(flight.steps.phase.tolist())
    assert {Phase.HOLD, Phase.CLIMB, Phase.ABORT} <= phases
    assert Phase.LANDED not in phases
    last = flight.truth
    distance = ((last.position_enu_m[-1, :2] - last.pad_position_enu_m[-1, :2]) ** 2).sum() ** 0.5
    assert distance > 0.8
    assert not last.motors_running[-1]


def test_a_killed_recorder_does_not_stop_the_landing_and_leaves_a_readable_log(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.wait_for("-> APPROACH")
    log = run.some_log()
    kill(run.children()["record"])
    run.wait_for("-> LANDED")
    assert run.end() == 1  # landed, but the record of it is not whole
    flight = load_flight(log)
    assert not flight.complete
    assert len(flight.steps.tick) > 100


def test_a_killed_vehicle_ends_the_run(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.wait_for("-> APPROACH")
    kill(run.children()["vehicle"])
    assert run.end() == 1
    assert any("vehicle ended in flight" in line for line in run.lines), run.lines


def test_a_time_limit_ends_a_run_as_an_abort_that_lands(tmp_path):
    result = fly(tmp_path, "paper_moving_1", 0, "--duration", "6")
    assert result.code == 1
    assert result.json["outcome"] == "aborted"
    assert not load_flight(result.json["log"]).truth.motors_running[-1]
