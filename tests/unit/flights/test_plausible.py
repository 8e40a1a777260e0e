"""Tests the rejection of values that contradict each other, and of clocks that differ."""

from __future__ import annotations

import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sim.flights.recording import PWM_MAX, RecordingError
from sim.flights.screening import clock_lag_s, load, screen
from tests.examples import examples
from tests.unit.flights.test_recording import RATE_HZ, flight, read


def wobbling(seconds=16.0, late_s=0.0):
    """Return a flight that rolls and pitches; ``late_s``: delay of the logged gyro rates."""
    columns = flight(seconds)
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)

    def attitude(at):
        roll, pitch = 0.1 * np.sin(6.0 * at) + 0.05 * np.sin(1.7 * at), 0.08 * np.sin(4.1 * at)
        return Rotation.from_euler("ZYX", np.stack([0.0 * at, pitch, roll], axis=1))

    turned, logged = attitude(t), attitude(t - late_s)
    for name, values in zip(("qw", "qx", "qy", "qz"), turned.as_quat(scalar_first=True).T, strict=True):
        columns[name] = values
    rates = np.gradient(logged.as_euler("xyz"), t, axis=0)  # turn rates, rad/s; the angles are small
    for axis, values in zip("xyz", rates.T, strict=True):
        columns[f"imu_gyro_{axis}"] = values
    columns["sp_ctrltarget_x"] = columns["px"]
    columns["sp_ctrltarget_y"] = columns["py"]
    for axis in "xyz":
        columns[f"est_stateEstimate_v{axis}"] = columns[f"v{axis}"]
    return columns


def written(tmp_path, columns):
    path = tmp_path / "flight.parquet"
    pa.parquet.write_table(pa.table(columns), path)
    return path


def test_a_flight_in_the_expected_units_is_used(tmp_path):
    found = load(written(tmp_path, wobbling()))
    assert found.usable
    assert not found.left_out


@pytest.mark.parametrize(
    ("names", "factor", "says"),
    [
        (("px", "py", "pz"), 1000.0, "position: the flight is .* wide; .* its columns, in m?"),
        (("vx", "vy", "vz"), 1000.0, r"^velocity: 951 times the derivative .* in m/s\?$"),
        (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), 180.0 / math.pi, "rates: 56.6 times the .* in rad/s?"),
        (tuple(f"motor_motor_m{i}" for i in (1, 2, 3, 4)), 1.0 / PWM_MAX, "pwm: the median is .* in PWM?"),
        (("pwr_pm_vbat",), 1000.0, "battery: the median is .* in V?"),
        (tuple(f"est_stateEstimate_{a}" for a in "xyz"), 100.0, "estimate_position: 100 times the position"),
        (tuple(f"est_stateEstimate_v{a}" for a in "xyz"), 1000.0, "estimate_velocity: 1e.03 times"),
        (("sp_ctrltarget_x", "sp_ctrltarget_y"), 1000.0, "setpoint_position: 832 times the position"),
        (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), 9000.0, "rates: .* are these its columns"),
        (("imu_gyro_x", "imu_gyro_y", "imu_gyro_z"), 0.0, "rates: 0 times .* are these its columns"),
        (("imu_gyro_y",), -1.0, "rates: column 2 is opposite to the attitude; mend its sign"),
    ],
)  # fmt: skip
def test_other_units_and_signs_are_noticed_and_named(tmp_path, names, factor, says):
    columns = wobbling()
    for name in names:
        columns[name] = factor * columns[name]
    with pytest.raises(RecordingError, match=says):
        load(written(tmp_path, columns))


@pytest.mark.parametrize(("order", "says"), [("xwyz", "tilted by 1.. degrees"), ("xyzw", "or the attitude")])
def test_a_quaternion_in_another_order_is_noticed(tmp_path, order, says):
    columns = wobbling()
    columns["qw"], columns["qx"], columns["qy"], columns["qz"] = (columns[f"q{c}"] for c in order)
    with pytest.raises(RecordingError, match=says):
        load(written(tmp_path, columns))


@examples(20)
@given(late_s=st.floats(-0.2, 0.2))
def test_the_lag_of_the_log_is_found(tmp_path_factory, late_s):
    found = clock_lag_s(read(tmp_path_factory.mktemp("late"), wobbling(late_s=late_s)))
    assert np.nanmedian(found) == pytest.approx(late_s, abs=0.021)


def test_the_part_of_a_flight_with_another_clock_is_left_out(tmp_path):
    t = np.arange(0.0, 40.0, 1.0 / RATE_HZ)
    found = screen(read(tmp_path, wobbling(40.0, late_s=np.where(t > 25.0, 0.12, 0.0))))
    (reason,) = found.left_out
    assert reason.text == "clocks of log and motion capture differ by up to 120 ms"
    assert reason.seconds == pytest.approx(14.5, abs=2.0)
    (piece,) = found.pieces
    assert piece.stop / RATE_HZ == pytest.approx(25.0, abs=2.0)


def test_a_flight_that_is_damaged_for_long_is_not_used_at_all(tmp_path):
    columns = wobbling(30.0)
    columns["est_stateEstimate_x"] = columns["est_stateEstimate_x"].copy()
    columns["est_stateEstimate_x"][1000:1300] += 2.0
    found = screen(read(tmp_path, columns))
    assert not found.usable
    assert "damaged for 3.2 s of" in found.left_out[-1].text
