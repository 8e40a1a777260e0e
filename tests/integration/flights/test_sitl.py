"""Whole runs with separate processes: landings, kills and interruptions, and faults with the required end."""

import re
import signal
import time

import pytest

from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from tests.integration.runs import Flying, flightstack, fly, gone, kill, replayed

PAPER = {("paper_static_1", "paper"): (), ("paper_moving_2", "robust"): ("--filter", "robust")}
KEYS = {
    "scenario", "seed", "filter", "outcome", "violation", "h_min_m", "h_min_outside_pad_m",
    "touchdown_error_m", "touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s", "time_to_land_s",
    "realtime_factor", "log", "report", "records_lost", "outside_envelope", "judged_apart",
}  # fmt: skip


def assert_decided_again(log):
    found = replayed(log)
    assert found["phases_recorded"][-1]["phase"] == "LANDED"
    assert found["compared"] > 500


@pytest.mark.parametrize(("scenario", "filter_name"), PAPER)
def test_the_papers_runs_land_and_replay_bit_by_bit(flown, scenario, filter_name):
    result = flown(scenario, 0, *PAPER[scenario, filter_name])
    assert result.code == 0, result.err
    found = result.json
    assert set(found) >= KEYS
    assert (found["scenario"], found["seed"], found["filter"]) == (scenario, 0, filter_name)
    assert found["outcome"] == "landed"
    assert found["judged_from"] == "truth"
    assert found["touchdown_error_m"] <= 0.10
    assert -0.2 < found["h_min_outside_pad_m"] < 1.0
    assert_decided_again(result.log)


def test_a_robot_that_stops_and_a_start_in_hover_land_by_contact_and_replay(flown):
    result = flown("stop_and_go")
    assert result.code == 0, result.err
    assert result.json["outcome"] == "landed"
    assert result.json["touchdown_error_m"] <= 0.10
    assert result.json["touchdown_speed_vertical_m_s"] < 0.35  # a powered descent; a fall from 5 cm: 0.75 m/s
    assert_decided_again(result.log)


def test_the_same_seed_makes_the_same_log(flown, tmp_path):
    assert fly(tmp_path, "paper_moving_2", 0).code == 0
    same = flightstack("compare", flown("paper_moving_2", 0).log, tmp_path / "flight.mcap")
    assert (same.code, same.out.strip().splitlines()[-1]) == (0, "equal"), same.out


def test_an_interrupted_run_ends_everything_and_says_what_was_reached(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.until("-> TAKEOFF")
    children = run.children()
    assert set(children) == {"record", "world", "onboard"}
    run.process.send_signal(signal.SIGINT)
    assert run.end() == 1
    # aborted after arming, so that the vehicle is commanded to land before the process ends
    assert any(re.search(r"outcome\W+(aborted|timeout)", line) for line in run.lines), run.lines
    assert all(gone(pid) for pid in children.values())
    flight = load_flight(tmp_path / "flight.mcap")
    assert flight.complete
    assert len(flight.steps.tick) > 0


def test_a_world_that_stands_still_for_some_seconds_only_delays_a_lockstep_flight(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_moving_1", "--lockstep")
    run.until("-> TAKEOFF")
    world = run.children()["world"]
    kill(world, signal.SIGSTOP)
    time.sleep(6.0)  # longer than the lease of a real-time connection
    kill(world, signal.SIGCONT)
    assert run.end() == 0
    steps = load_flight(tmp_path / "flight.mcap").steps
    assert steps.phase[-1] == Phase.LANDED
    assert Phase.HOLD not in steps.phase


def test_a_killed_world_ends_the_run(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.until("-> TAKEOFF")  # the first of ten seconds, which lockstep simulates in half a second
    kill(run.children()["world"])
    assert run.end() == 1
    assert any("world ended in flight" in line for line in run.lines), run.lines
