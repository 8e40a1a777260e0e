"""Tests the reading of recorded flights, and which files and parts are rejected."""

from __future__ import annotations

import math

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from sim.flights.recording import PWM_MAX, QUANTITIES, RecordingError, read_recording
from sim.flights.screening import screen

RATE_HZ = 100.0


def flight(seconds: float = 12.0) -> dict[str, np.ndarray]:
    """Return the columns of a flight: 2 s on the ground, then a circle of 0.5 m/s at 1 m height."""
    t = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    air = np.clip((t - 2.0) / 0.5, 0.0, 1.0)
    zero, one = np.zeros_like(t), np.ones_like(t)
    columns = {name: zero for each in QUANTITIES.values() for name in each.columns}
    columns |= {
        "t": 1.7e9 + t, "px": np.cos(0.5 * t), "py": np.sin(0.5 * t), "pz": 0.05 + air, "qw": one,
        "vx": -0.5 * np.sin(0.5 * t), "vy": 0.5 * np.cos(0.5 * t), "pwr_pm_vbat": 3.7 * one,
    }  # fmt: skip
    columns |= {f"motor_motor_m{i}": 50000.0 * (air > 0.0) for i in (1, 2, 3, 4)}
    columns |= {f"est_stateEstimate_{axis}": columns[f"p{axis}"] for axis in "xyz"}
    return columns


def read(tmp_path, columns, suffix=".parquet"):
    path = tmp_path / f"flight{suffix}"
    table = pa.table(columns)
    if suffix == ".csv":
        pa.csv.write_csv(table, path)
    else:
        pa.parquet.write_table(table, path)
    return read_recording(path)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_units_and_signs_become_those_of_the_project(tmp_path, suffix):
    columns = flight()
    columns["sp_ctrltarget_yaw"] = np.full_like(columns["t"], 10.0)
    found = read(tmp_path, columns, suffix)
    assert found.time_s[0] == 0.0
    assert found.step_s == pytest.approx(1.0 / RATE_HZ, rel=1e-4)
    assert found.duty.max() == pytest.approx(50000.0 / PWM_MAX)
    assert found.setpoint_yaw_rad[0] == pytest.approx(math.radians(10.0))
    assert not found.by_pid


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"px": None}, "columns of position not found: px"),
        ({"pz": np.array(["high"] * 1200)}, "are not numbers"),
        ({"t": np.zeros(1200)}, "does not increase"),
        ({"t": np.full(1200, np.nan)}, "does not increase"),
    ],
)
def test_a_flight_that_cannot_be_read_says_why(tmp_path, change, says):
    columns = flight() | change
    with pytest.raises(RecordingError, match=says):
        read(tmp_path, {name: values for name, values in columns.items() if values is not None})


def test_a_whole_flight_is_used_but_for_the_ground(tmp_path):
    found = screen(read(tmp_path, flight()))
    assert not found.left_out
    assert len(found.pieces) == 1
    assert found.seconds == pytest.approx(9.4, abs=0.3)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("motor_motor_m2", 1.9e6, "motor commands outside"),
        ("px", np.nan, "values missing"),
        ("py", 50.0, "motion capture jumps"),
        ("est_stateEstimate_x", 4000.0, "estimate more than"),
        ("pwr_pm_vbat", 0.0, "battery outside"),
    ],
)
def test_damage_is_cut_out_with_a_margin_and_said(tmp_path, column, value, says):
    columns = flight()
    columns[column] = columns[column].copy()
    columns[column][800:803] = value
    found = screen(read(tmp_path, columns))
    assert any(says in reason.text for reason in found.left_out)
    assert len(found.pieces) == 2
    assert found.pieces[0].stop <= 790
    assert found.pieces[1].start >= 812


def test_missing_samples_and_a_frozen_pose_part_a_flight(tmp_path):
    columns = flight(20.0)
    for name in ("px", "py", "pz"):
        columns[name] = columns[name].copy()
        columns[name][600:620] = columns[name][600]
    keep = np.ones(len(columns["t"]), dtype=bool)
    keep[1200:1230] = False
    found = screen(read(tmp_path, {name: values[keep] for name, values in columns.items()}))
    assert {reason.text for reason in found.left_out} >= {"samples missing", "motion capture frozen"}
    assert len(found.pieces) == 3
