"""A recorded flight of a real vehicle, read from Parquet or CSV, in SI units.

World axes have z up and the horizontal axes of the room (ENU if the room's x is called east). The body frame
is FLU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from flightstack.common.strict_toml import decoded

Floats = NDArray[np.float64]

SUFFIXES = (".parquet", ".csv")
PWM_MAX = 65535.0  # Crazyflie firmware motors.c: 16-bit PWM
SAMPLES_MIN = 200  # minimum number of samples: 2 s at 100 Hz


class RecordingError(ValueError):
    """A recording that cannot be used; the message has the value found and the allowed values."""


def _axes(prefix: str) -> tuple[str, ...]:
    return tuple(prefix + axis for axis in "xyz")


class Quantity(NamedTuple):
    """Columns of a recording that contain one quantity."""

    field: str  # field of ``Recording``
    columns: tuple[str, ...]  # names of the columns
    unit: str
    factor: float = 1.0  # factor from the unit to SI units (for PWM: to the duty cycle, 0 to 1)
    required: bool = True  # whether a recording without these columns is rejected


# columns as published with NanoBench (arXiv 2603.09908); most names are names of the firmware's log variables
QUANTITIES: Mapping[str, Quantity] = {
    "time": Quantity("time_s", ("t",), "s"),
    "position": Quantity("position_m", ("px", "py", "pz"), "m"),
    "attitude": Quantity("attitude", ("qw", "qx", "qy", "qz"), "1"),
    "rates": Quantity("rates_rad_s", _axes("imu_gyro_"), "rad/s"),
    "pwm": Quantity("duty", tuple(f"motor_motor_m{i}" for i in range(1, 5)), "PWM", 1.0 / PWM_MAX),
    "battery": Quantity("battery_v", ("pwr_pm_vbat",), "V"),
    "velocity": Quantity("velocity_m_s", ("vx", "vy", "vz"), "m/s", 1.0, False),
    "estimate_position": Quantity("estimate_position_m", _axes("est_stateEstimate_"), "m", 1.0, False),
    "estimate_velocity": Quantity("estimate_velocity_m_s", _axes("est_stateEstimate_v"), "m/s", 1.0, False),
    "setpoint_position": Quantity("setpoint_position_m", _axes("sp_ctrltarget_"), "m", 1.0, False),
    "setpoint_yaw": Quantity("setpoint_yaw_rad", ("sp_ctrltarget_yaw",), "deg", math.pi / 180.0, False),
    "thrust_command": Quantity("thrust_command", ("pid_controller_cmd_thrust",), "PWM", 1.0 / PWM_MAX, False),
}


@dataclass(frozen=True, slots=True)
class Recording:
    """One flight of n samples. Optional arrays are ``None`` if the file has no such columns."""

    name: str  # name of the file without suffix
    time_s: Floats  # (n,) time since the first sample
    position_m: Floats  # (n, 3) position from motion capture
    velocity_m_s: Floats  # (n, 3) velocity from motion capture
    attitude: Floats  # (n, 4) attitude from motion capture, unit quaternion w, x, y, z, body FLU to world
    rates_rad_s: Floats  # (n, 3) gyro reading, body FLU
    duty: Floats  # (n, 4) duty cycles of the motors M1 to M4, 0 to 1
    battery_v: Floats  # (n,) voltage under load
    # (n, 3) position and velocity that the on-board estimator reported
    estimate_position_m: Floats | None = None
    estimate_velocity_m_s: Floats | None = None
    setpoint_position_m: Floats | None = None  # (n, 3) position set-points, world
    setpoint_yaw_rad: Floats | None = None  # (n,) yaw set-points
    thrust_command: Floats | None = None  # (n,) thrust command of the PID controller, 0 to 1
    step_s: float = 0.01  # median time between two samples

    @property
    def by_pid(self) -> bool:
        """Whether the PID controller flew; with Mellinger the thrust command is always zero."""
        return self.thrust_command is None or bool(np.any(self.thrust_command > 0.0))


def read_recording(path: Path) -> Recording:
    """Read the file of one recorded flight and convert its columns to SI units.

    Raises RecordingError: unreadable file, columns missing or not numeric, too few samples, or no time.
    """
    if path.exists() and not path.is_file():
        raise RecordingError("it is a folder, pipe or device; a file is needed")
    try:
        if path.suffix == ".csv":
            table = pa.csv.read_csv(pa.BufferReader(decoded(path.read_bytes()).encode()))
        else:
            table = pa.parquet.read_table(path)
        names = table.column_names
    except (OSError, ValueError, pa.ArrowException) as error:
        raise RecordingError(f"can't be read: {str(error).partition(chr(10))[0]}") from error
    arrays: dict[str, Floats] = {}
    for name, quantity in QUANTITIES.items():
        missing = [column for column in quantity.columns if column not in names]
        if missing and quantity.required:
            raise RecordingError(
                f"columns of {name} not found: {', '.join(missing)}; the file has {', '.join(names[:8])}, ..."
            )
        double = [column for column in quantity.columns if names.count(column) > 1]
        if double:
            raise RecordingError(f"columns of {name} are there several times: {', '.join(double)}")
        if not missing:
            arrays[quantity.field] = _numbers(table, quantity)
    if len(arrays["time_s"]) < SAMPLES_MIN:
        raise RecordingError(f"found {len(arrays['time_s'])} samples, at least {SAMPLES_MIN} are needed")
    return _recording(path.stem, arrays)


def _numbers(table: pa.Table, quantity: Quantity) -> Floats:
    try:
        made = [quantity.factor * np.asarray(table[c].to_numpy(), dtype=np.float64) for c in quantity.columns]
    except (ValueError, TypeError, pa.ArrowException) as error:
        raise RecordingError(f"columns {', '.join(quantity.columns)} are not numbers: {error}") from error
    values = made[0] if len(made) == 1 else np.stack(made, axis=1)
    values[~np.isfinite(values)] = np.nan  # treat infinite values as missing
    return values


def _recording(name: str, arrays: dict[str, Floats]) -> Recording:
    arrays["time_s"] = time_s = arrays["time_s"] - arrays["time_s"][0]
    steps = np.diff(time_s)
    if not np.all(np.isfinite(steps)) or not np.all(steps > 0.0):
        raise RecordingError("the time does not increase from sample to sample")
    if "velocity_m_s" not in arrays:
        arrays["velocity_m_s"] = np.gradient(arrays["position_m"], time_s, axis=0)
    norm = np.linalg.norm(arrays["attitude"], axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        arrays["attitude"] = arrays["attitude"] / norm
    return Recording(name, **arrays, step_s=float(np.median(steps)))
