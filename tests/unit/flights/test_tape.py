"""Tests error tapes: a recorded estimate is split into errors, which are added to the same or other paths."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from flightstack.compiled.records import cell, new
from sim.chance import stream
from sim.flights.recording import Recording, RecordingError
from sim.flights.screening import Screened
from sim.flights.tape import CUT_S, FLIGHTS, draw_tape, tape_folder, tape_of
from sim.plant.state_error import DELAY, WIDTH, PastRecord, TapeRows, _rows, mismeasured_path, state_errors
from sim.scenarios.scenario import load
from sim.scenarios.tables import StateError
from tests.recorded import PIECE

STEP_S = 0.01
PIECES = (slice(0, 1500), slice(1600, 3000))


def made(speed=0.6, delay=lambda t: 0.05 + 0.03 * np.sin(3.0 * t), velocity_error=0.0, seconds=30.0):
    """Return a flight on circles of 0.8 m radius, with a delayed state estimate."""
    t = np.arange(0.0, seconds, STEP_S)

    def path(at):
        angle = speed / 0.8 * at
        return np.stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), 1.0 + 0.1 * np.sin(angle)], axis=1)

    def moving(at):
        return (path(at + 1e-4) - path(at - 1e-4)) / 2e-4

    n, velocity = len(t), moving(t)
    upright = np.tile((1.0, 0.0, 0.0, 0.0), (n, 1))
    estimate = np.stack([np.interp(t - delay(t), t, column) for column in path(t).T], axis=1)
    turned = np.stack([-velocity[:, 1], velocity[:, 0], 0.0 * t], axis=1)
    recording = Recording(
        "made", t, path(t), velocity, upright, np.zeros((n, 3)), np.zeros((n, 4)), np.full(n, 3.7),
        estimate_position_m=estimate, estimate_velocity_m_s=velocity + velocity_error * turned,
        estimate_attitude_rad=np.tile((0.01, -0.02, 0.03), (n, 1)),
    )  # fmt: skip
    return Screened(recording, PIECES, ())


def test_a_tape_has_the_delay_and_little_else():
    flight = made()
    tape = tape_of(flight)
    cut = round(CUT_S / STEP_S)
    for piece, recorded in zip(tape.pieces, PIECES, strict=True):
        t = flight.recording.time_s[recorded.start + cut : recorded.stop - cut]
        assert piece.delay_s == pytest.approx(0.05 + 0.03 * np.sin(3.0 * t), abs=2e-3)
        assert np.abs(piece.position_m).max() < 2e-3
        assert np.abs(piece.along).max() < 0.03
        assert piece.turn_rad[0] == pytest.approx((0.01, -0.02, 0.03), abs=1e-3)


def test_an_error_across_the_velocity_is_a_share_of_it():
    tape = tape_of(made(delay=lambda t: 0.0 * t, velocity_error=0.1, speed=0.8))
    piece = tape.pieces[0]
    found = piece.across * (piece.speed_m_s + 0.54)
    left = found - 0.8 * piece.velocity_delay_s  # centripetal 0.8 m/s2: error by the delay
    assert left == pytest.approx(0.08, abs=0.01)


def test_on_its_own_path_a_tape_gives_the_recorded_estimate_again():
    flight = made(velocity_error=0.05)
    r, cut = flight.recording, round(CUT_S / STEP_S)
    piece = PIECES[0]
    past = new(PastRecord)
    past.rate = 1.0 / STEP_S
    rows = np.zeros((piece.stop - piece.start, WIDTH))
    rows[cut:-cut] = _rows(tape_of(flight).pieces[0])
    states = np.empty((len(rows), 6))
    mismeasured_path(cell(past), r.position_m[piece], r.velocity_m_s[piece], rows, states)
    assert states[cut:-cut, :3] == pytest.approx(r.estimate_position_m[piece][cut:-cut], abs=1e-9)
    assert states[cut:-cut, 3:] == pytest.approx(r.estimate_velocity_m_s[piece][cut:-cut], abs=5e-3)


def test_flights_without_an_estimate_too_slow_or_too_short_give_no_tape():
    flight = made()
    assert tape_of(replace(flight, recording=replace(flight.recording, estimate_velocity_m_s=None))) is None
    assert tape_of(replace(flight, pieces=(slice(0, 100),))) is None
    assert tape_of(replace(flight, pieces=())) is None
    assert tape_of(made(speed=0.1)) is None


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 250.0])
def test_cuts_are_joined_without_a_jump_at_any_rate(rate_hz):
    tape = tape_of(made())
    rows = TapeRows(tape, stream(1, "test"), rate_hz).take(6000)
    assert rows.shape == (6000, WIDTH)
    recorded = np.concatenate([piece.delay_s for piece in tape.pieces])
    assert rows[:, DELAY].mean() == pytest.approx(recorded.mean(), abs=5e-3)
    assert rows[:, DELAY].std() == pytest.approx(recorded.std(), rel=0.1)
    assert rows[:, DELAY].min() >= recorded.min()
    assert rows[:, DELAY].max() <= recorded.max()
    steps = np.abs(np.diff(rows[:, DELAY]))
    assert steps.max() < (0.06 / 0.2 + 0.09) / rate_hz + 1e-3  # joins change the delay by up to 60 ms


@pytest.fixture
def folder(tmp_path):
    """Return a folder with one recorded flight and a file that is not a flight."""
    shutil.copy(PIECE, tmp_path / "b.parquet")
    (tmp_path / "a.csv").write_text("t,px\n0.0,1.0\n")
    return tmp_path


def test_a_run_draws_a_flight_that_can_be_used(folder):
    for seed in range(4):
        assert draw_tape(folder, stream(seed, "test")).name == "b"
    spec = StateError(tape=str(folder))
    rows = {purpose: state_errors(spec, 3, purpose, 100.0).take(2000) for purpose in ("own", "target")}
    assert not np.array_equal(rows["own"], rows["target"])
    assert np.array_equal(rows["own"], state_errors(spec, 3, "own", 100.0).take(2000))


def test_a_tape_is_beside_the_scenario_or_where_the_variable_says(folder, tmp_path, monkeypatch):
    monkeypatch.delenv(FLIGHTS, raising=False)
    monkeypatch.chdir(tmp_path)
    scenario = tmp_path / "scenarios" / "mine.toml"
    (scenario.parent / "near").mkdir(parents=True)
    text = 'base = "lab"\nname = "mine"\n[vehicle.own]\ntape = "{}"\n[odometry.error]\ntape = "{}"\n'
    scenario.write_text(text.format("near", "far"))
    found = load(scenario)
    assert found.vehicle.own.tape == str(scenario.parent / "near")
    assert found.odometry.error.tape == "far"
    with pytest.raises(
        RecordingError, match=r"found no folder 'far'.*FLIGHTSTACK_FLIGHTS is not set; set it"
    ):
        tape_folder("far")
    monkeypatch.setenv(FLIGHTS, str(folder))
    assert tape_folder("far") == folder
    with pytest.raises(RecordingError, match="found no folder '/far'"):
        tape_folder("/far")
    monkeypatch.setenv(FLIGHTS, str(folder / "none"))
    with pytest.raises(RecordingError, match=r"is '.*none'; set it"):
        tape_folder("far")
