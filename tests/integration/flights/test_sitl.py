"""Tests runs with separate processes: landings, kills, interruptions, and faults with the required end."""

import re
import signal
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from flightstack.core.types import ZERO, Phase
from flightstack.onboard.lockstep import WORLD_SILENT_S
from logs.reader.flight import load_flight
from sim.runners.landing import land
from sim.scenarios.scenario import load
from tests.integration.runs import Flying, flightstack, fly, kill, replayed
from tests.processes.bounded import gone

RUNS = [
    ("paper_static_1", 0, ()),  # flight that starts on the ground
    ("paper_moving_2", 0, ("--filter", "robust")),
    ("stop_and_go", 0, ()),  # flight that starts in hover
    ("room", 1, ()),  # scenario with state errors, an estimator and a thrust reserve
    ("storm", 1, ()),  # scenario with lost samples and wind
    ("fault_target_dropout", 0, ()),
    (str(Path(__file__).with_name("captured.toml")), 1, ()),
]
SEEN = ("t_s", "phase", "own_age_s", "target_age_s")
KEYS = {
    "scenario", "seed", "filter", "outcome", "violation", "h_min_m", "h_min_outside_pad_m",
    "touchdown_error_m", "touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s", "time_to_land_s",
    "realtime_factor", "log", "report", "records_lost", "outside_envelope", "judged_apart",
}  # fmt: skip


@pytest.mark.parametrize(("scenario", "seed", "options"), RUNS)
def test_a_landing_over_the_wires_equals_the_same_in_one_process_and_replays(flown, scenario, seed, options):
    commands = []

    def keep(_tick, out):
        commands.append(out.setpoint.velocity_enu_m_s if out.setpoint is not None else ZERO)

    here = load(scenario).with_filter(options[1]) if options else load(scenario)
    landing, wired = land(here, seed, on_step=keep), flown(scenario, seed, *options)
    result, verdict = wired.json, landing.verdict.to_json_dict()
    assert set(result) >= KEYS
    assert (result["seed"], result["filter"], result["judged_from"]) == (seed, here.onboard.filter, "truth")
    assert {key: result[key] for key in verdict} == verdict
    flight = load_flight(wired.log)
    assert np.array_equal(flight.steps.command_enu_m_s, np.array(commands))
    for part, names in (("steps", SEEN), ("truth", [field.name for field in fields(flight.truth)])):
        for name in names:
            seen, logged = (getattr(getattr(each, part), name) for each in (landing.seen, flight))
            assert np.array_equal(seen, logged, equal_nan=logged.dtype.kind == "f"), name
    again = replayed(wired.log)
    assert again["phases_recorded"][-1]["phase"] == Phase(flight.steps.phase[-1]).name
    assert again["compared"] == len(commands)


def test_the_same_seed_makes_the_same_log(flown, tmp_path):
    assert fly(tmp_path, "paper_moving_2", 0).code == 0
    same = flightstack("compare", flown("paper_moving_2", 0).log, tmp_path / "flight.mcap")
    assert (same.code, same.out.strip().splitlines()[-1]) == (0, "equal"), same.out


def test_an_interrupted_run_ends_everything_and_says_what_was_reached(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.until("-> TAKEOFF")
    children = run.children()
    assert set(children) == {"record", "world", "onboard-cf1"}
    run.process.send_signal(signal.SIGINT)
    assert run.end() == 1
    # the abort comes after arming, so the process must command a landing before it ends
    assert any(re.match(r"\W*cf1\W+(aborted|timeout)\b", line) for line in run.lines), run.lines
    assert all(gone(pid) for pid in children.values())
    flight = load_flight(tmp_path / "flight.mcap")
    assert flight.complete
    assert len(flight.steps.tick) > 0


def test_a_world_that_stands_still_for_some_seconds_only_delays_a_lockstep_flight(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_moving_1", "--lockstep")
    run.until("-> TAKEOFF")
    world = run.children()["world"]
    kill(world, signal.SIGSTOP)
    time.sleep(6.0)  # longer than the Zenoh lease of a connection in real time
    kill(world, signal.SIGCONT)
    assert run.end() == 0
    steps = load_flight(tmp_path / "flight.mcap").steps
    assert steps.phase[-1] == Phase.LANDED
    assert Phase.HOLD not in steps.phase


def test_a_killed_world_ends_the_run(tmp_path):
    run = Flying(tmp_path, "--scenario", "paper_static_2", "--lockstep")
    run.until("-> TAKEOFF")  # 10 s of simulated time before the landing, half a second of wall time
    kill(run.children()["world"])
    began_s = time.monotonic()
    assert run.end() == 1
    assert time.monotonic() - began_s < WORLD_SILENT_S / 2  # no tick can follow, so none is awaited
    assert any("world ended in flight" in line for line in run.lines), run.lines
