"""Tests logs of separate processes: exact replay, playback, and verdicts with and without true states."""

import math
from dataclasses import replace

import pytest

from logs.reader.flight import load_flight
from logs.reader.reader import LogFile
from logs.verdict.verdict import judge
from tests.golden.flights import write_kept
from tests.integration.runs import flightstack, replayed


def test_a_real_time_flight_replays_bit_by_bit_inputs_from_the_wire_included(tmp_path):
    words = ("sitl", "--scenario", "straight", "--duration", 6, "--no-report", "--json")
    flown = flightstack(*words, "--out", tmp_path)
    assert (flown.code, flown.json["outcome"]) == (1, "aborted")  # the time-out is intended
    assert not load_flight(flown.json["log"]).truth.motors_running[-1]
    found = replayed(tmp_path / "flight.mcap")
    assert "APPROACH" in {change["phase"] for change in found["phases_recorded"]}
    (config,) = [a for a in LogFile(tmp_path / "flight.mcap").attachments() if a.name == "cf1/onboard.toml"]
    assert b"alpha_1_m" in config.data


# maximum differences between the verdicts from the estimate and from true states: touchdown error, m; other
# values, m/s or s. The target is measured to 1 cm or better in these flights, so
# the limits show the errors of the method.
ERROR_M, SPEED_M_S = 0.015, 0.05
FLIGHTS = [("paper_moving_1", 0), ("large", 0), ("lab", 1), ("stop_and_go", 0)]


def onboard_only(log, out, to_s=None):
    """Copy the topics that a real flight logs (of the onboard process), up to ``to_s`` after the start."""
    begin_ns = next(LogFile(log).messages()).log_time_ns
    until_ns = math.inf if to_s is None else begin_ns + to_s * 1e9
    return write_kept(log, out, wire=False, when=lambda m: m.log_time_ns <= until_ns)


@pytest.mark.parametrize(("scenario", "seed"), FLIGHTS)
def test_the_estimate_gives_the_verdict_of_the_truth(flown, scenario, seed):
    flight = load_flight(flown(scenario, seed).log)
    pad_m = flight.config.touchdown.pad_radius_m
    true, seen = judge(flight), judge(replace(flight, truth=None, metadata={}, pad_radius_m=pad_m))
    assert (true.judged_from, seen.judged_from) == ("truth", "estimate")
    assert (seen.outcome, seen.violation) == (true.outcome, true.violation), seen.reason
    assert seen.touchdown_error_m == pytest.approx(true.touchdown_error_m, abs=ERROR_M)
    for name in ("touchdown_speed_vertical_m_s", "touchdown_speed_horizontal_m_s", "time_to_land_s"):
        assert getattr(seen, name) == pytest.approx(getattr(true, name), abs=SPEED_M_S), name


def test_log_verdict_has_the_keys_of_sitl_and_says_what_it_judged_from(flown, tmp_path):
    flight = flown("large", 0)
    told = flightstack("log", "verdict", flight.log, "--json")
    assert (told.code, list(told.json)) == (0, list(flight.json))
    apart = {"realtime_factor", "report", "log"}
    assert {k: v for k, v in told.json.items() if k not in apart} == {
        k: v for k, v in flight.json.items() if k not in apart
    }
    real = tmp_path / "real.mcap"
    onboard_only(flight.log, real)
    told = flightstack("log", "verdict", real, "--json")
    assert (told.code, told.json["judged_from"], told.json["outcome"]) == (0, "estimate", "landed")
    assert "judged from the vehicle's own estimate" in flightstack("log", "verdict", real).out


@pytest.mark.parametrize("to_s", [1, 5, 8.9, 10.0])
def test_a_flight_that_is_cut_never_landed(flown, tmp_path, to_s):
    log = onboard_only(flown("large", 0).log, tmp_path / "real.mcap", to_s)
    told = flightstack("log", "verdict", log, "--json")
    assert (told.code, told.json["outcome"]) == (1, "timeout"), told.out
