"""Tests a log as arrays: values and times are correct, and missing values remain missing."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from flightstack.common.pacing import EPOCH_NS
from flightstack.core.safety.barrier import Barrier
from flightstack.core.types import Phase
from logs.reader.flight import load_flight
from logs.reader.reader import LogError
from logs.recorder.recording import McapFile
from logs.replay.replay import ReplayError, replay
from logs.schema import schemas
from logs.verdict.verdict import judged_apart
from tests.synthetic_flight import landing, write_log


@pytest.fixture
def log(tmp_path):
    return tmp_path / "flight.mcap"


def test_arrays_hold_what_was_written(log):
    rows = landing()
    flight = load_flight(write_log(log, rows))
    assert flight.complete
    assert flight.problems == ()
    assert flight.origin_ns == EPOCH_NS
    assert flight.duration_s == pytest.approx((len(rows.steps) - 1) * 0.01)
    assert (flight.barrier.alpha_1_m, flight.barrier.beta_m) == (1.0, 1.5)
    for index in (0, 500, len(rows.steps) - 1):
        step, true, timing = rows.steps[index], rows.truth[index], rows.timing[index]
        assert flight.steps.t_s[index] == pytest.approx(index * 0.01)
        for name in ("phase", "gate", "own_age_s", "h_m", "iterations", "barrier_active", "target_accepted"):
            assert getattr(flight.steps, name)[index] == getattr(step, name)
        for name in ("own_position_enu_m", "target_velocity_enu_m_s", "filtered_enu_m_s", "command_enu_m_s"):
            assert np.array_equal(getattr(flight.steps, name)[index], getattr(step, name), equal_nan=True)
        for name in ("contacts", "motors_running", "h_min_outside_pad_m", "pad_yaw_rad", "battery_v"):
            assert getattr(flight.truth, name)[index] == getattr(true, name)
        assert tuple(flight.truth.pad_position_enu_m[index]) == true.pad_position_enu_m
        assert tuple(flight.truth.orientation[index]) == true.orientation
        assert flight.timing.solve_s[index] == timing.solve_s
    assert len(flight.target.t_s) == len(rows.odometry)
    assert np.allclose(flight.target.position_enu_m[-1], rows.truth[-1].pad_position_enu_m)


def test_landing_start_and_phase_spans(log):
    rows = landing()
    flight = load_flight(write_log(log, rows))
    assert flight.landing_start_s == pytest.approx(rows.begin_tick * 0.01)
    spans = flight.phase_spans()
    assert [phase for phase, _, _ in spans] == [Phase(n) for n in range(6)]
    assert all(a[2] == b[1] for a, b in itertools.pairwise(spans))
    assert spans[-1][2] == flight.steps.t_s[-1]


def test_estimate_is_nan_where_an_input_was_not_valid(log):
    rows = landing()
    rows.steps[400] = rows.steps[400]._replace(target_valid=False)
    flight = load_flight(write_log(log, rows))
    assert np.isnan(flight.steps.e_m[400]).all()
    assert math.isnan(flight.steps.d_m[400])
    assert np.isfinite(flight.steps.e_m[[399, 401]]).all()


def test_a_vehicle_carried_by_a_turning_pad_is_at_rest(log):
    rows = landing()
    flight = load_flight(write_log(log, rows))
    resting = flight.truth.relative_velocity_m_s[rows.touch + 50 :]
    assert np.abs(resting).max() < 0.01


def test_missing_topics_are_none(log):
    rows = landing()
    rows.truth, rows.timing, rows.odometry = [], [], []
    flight = load_flight(write_log(log, rows))
    assert flight.truth is None
    assert flight.timing is None
    assert flight.target is None
    assert flight.steps is not None


def test_neither_steps_nor_truth_is_an_error(log):
    rows = landing()
    rows.steps, rows.truth = [], []
    with pytest.raises(LogError, match="controller steps"):
        load_flight(write_log(log, rows))


def test_barrier_from_the_configuration_if_the_run_names_none(log):
    writer = McapFile(log)
    rows = landing()
    channel = writer.channel("/cf1/controller/step", schemas.CONTROLLER_STEP)
    writer.write(channel, EPOCH_NS, EPOCH_NS, 0, rows.steps[0].pack())
    text = b"[barrier]\nalpha_1_m = 0.5\nbeta_m = 1.5\n"
    text += b"[limits]\nvelocity_max_m_s = [0.3, 0.3, 0.4]\n"
    writer.attachment("onboard.toml", "application/toml", EPOCH_NS, text)
    writer.close()
    flight = load_flight(log)
    assert (flight.barrier.alpha_1_m, flight.barrier.beta_m) == (0.5, 1.5)
    assert flight.config.limits.velocity_max_m_s == (0.3, 0.3, 0.4)
    assert judged_apart(flight) == ""
    apart = judged_apart(replace(flight, barrier=Barrier(1.0, 1.5)))
    assert apart == "judged by alpha 1.0 1/m, beta 1.5 m; flown with alpha 0.5 1/m, beta 1.5 m"


def test_one_bad_odometry_sample_is_counted_not_fatal(log):
    rows = landing()
    rows.odometry.insert(10, (rows.odometry[10][0], b"\x00\x01\x00\x00garbage"))
    flight = load_flight(write_log(log, rows))
    assert len(flight.target.t_s) == len(rows.odometry) - 1
    assert any("cannot be read" in p for p in flight.problems)


def test_a_log_with_other_fields_names_the_version_that_recorded_it(log, monkeypatch):
    def older(name):
        return schemas.schema_text(name).replace("float64 command_yaw_rad", "# ", 1)

    monkeypatch.setattr("logs.recorder.recording.schema_text", older)
    close = McapFile.close

    def made(self):
        self.metadata("made", {"version": "0.3.1", "git_revision": "abc"})
        close(self)

    monkeypatch.setattr(McapFile, "close", made)
    write_log(log, landing())
    told = r"another version of this stack: version 0.3.1 \(git abc\). The fields of its ControllerStep"
    with pytest.raises(LogError, match=told):
        load_flight(log)
    with pytest.raises(ReplayError, match=told):
        replay(log)
