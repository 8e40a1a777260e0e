"""A recorded flight of a real vehicle, read from Parquet or CSV by a table of columns, in SI units.

World axes have z up and the horizontal axes of the room (ENU if the room's x is called east). The body frame
is FLU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from flightstack.common.strict_toml import ConfigError, decoded, read_toml

Floats = NDArray[np.float64]

SUFFIXES = (".parquet", ".csv")
PWM_MAX = 65535.0  # Crazyflie firmware motors.c: 16-bit PWM
SAMPLES_MIN = 200  # minimum number of samples: 2 s at 100 Hz
COLUMNS = Path(__file__).with_name("crazyflie_vicon.toml")


class RecordingError(ValueError):
    """A recording that cannot be used; the message has the value found and the allowed values."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """Definition of a quantity that the columns of a recording contain."""

    field: str  # field of ``Recording``
    width: int  # number of columns
    # allowed units, each with the factor to SI units (for PWM: to the duty cycle, 0 to 1)
    units: Mapping[str, float]
    required: bool = False  # whether a recording without these columns is rejected


_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180.0}
_DUTY = {"PWM": 1.0 / PWM_MAX, "1": 1.0, "%": 1e-2}

QUANTITIES: dict[str, Quantity] = {
    "time": Quantity("time_s", 1, {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}, required=True),
    "position": Quantity("position_m", 3, _LENGTH, required=True),
    "velocity": Quantity("velocity_m_s", 3, _SPEED),
    "attitude": Quantity("attitude", 4, {"1": 1.0}, required=True),
    "rates": Quantity("rates_rad_s", 3, _RATE, required=True),
    "pwm": Quantity("duty", 4, _DUTY, required=True),
    "battery": Quantity("battery_v", 1, {"V": 1.0, "mV": 1e-3}, required=True),
    "estimate_position": Quantity("estimate_position_m", 3, _LENGTH),
    "estimate_velocity": Quantity("estimate_velocity_m_s", 3, _SPEED),
    "setpoint_position": Quantity("setpoint_position_m", 3, _LENGTH),
    "setpoint_yaw": Quantity("setpoint_yaw_rad", 1, _ANGLE),
    "thrust_command": Quantity("thrust_command", 1, _DUTY),
}


@dataclass(frozen=True, slots=True)
class Group:
    """Columns of a quantity, and their factors to SI units in the project's axes."""

    columns: tuple[str, ...]
    factors: tuple[float, ...]


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
    # estimate_position_m, estimate_velocity_m_s: (n, 3) output of the on-board estimator
    estimate_position_m: Floats | None = None
    estimate_velocity_m_s: Floats | None = None
    setpoint_position_m: Floats | None = None  # (n, 3) position set-points, world
    setpoint_yaw_rad: Floats | None = None  # (n,) yaw set-points
    thrust_command: Floats | None = None  # (n,) thrust command of the PID controller, 0 to 1
    step_s: float = field(default=0.01)

    @property
    def by_pid(self) -> bool:
        """Whether the PID controller flew; with Mellinger the thrust command is always zero."""
        return self.thrust_command is None or bool(np.any(self.thrust_command > 0.0))


def read_columns(path: Path = COLUMNS) -> dict[str, Group]:
    """Read the TOML file that gives column names and units for each quantity.

    Raises RecordingError: not TOML, an unknown quantity or unit, or the wrong number of columns.
    """
    try:
        tables = read_toml(path)
    except ConfigError as error:
        raise RecordingError(str(error)) from error
    for name in tables:
        if name not in QUANTITIES:
            raise RecordingError(
                f"{path}: [{name}]: found no such quantity; allowed: {', '.join(QUANTITIES)}"
            )
    for name, quantity in QUANTITIES.items():
        if quantity.required and name not in tables:
            raise RecordingError(f"{path}: [{name}] is missing; it needs {quantity.width} columns and a unit")
    return {name: _group(f"{path}: [{name}]", QUANTITIES[name], table) for name, table in tables.items()}


def _group(where: str, quantity: Quantity, table: object) -> Group:
    if not isinstance(table, dict) or not set(table) <= {"columns", "unit", "sign"}:
        raise RecordingError(f"{where}: found {table!r}; allowed: columns, unit, sign")
    columns, sign = (_list(where, table, key, quantity.width) for key in ("columns", "sign"))
    unit = table.get("unit")
    if not all(isinstance(c, str) for c in columns) or any(s not in (1, -1) for s in sign):
        raise RecordingError(f"{where}: columns are names, and signs are 1 or -1; found {columns}, {sign}")
    if not isinstance(unit, str) or unit not in quantity.units:
        raise RecordingError(f"{where}: unit: found {unit!r}; allowed: {', '.join(quantity.units)}")
    return Group(tuple(columns), tuple(s * quantity.units[unit] for s in sign))


def _list(where: str, table: dict[str, Any], key: str, width: int) -> list[Any]:
    found = table.get(key, [1] * width if key == "sign" else None)
    if not isinstance(found, list) or len(found) != width:
        raise RecordingError(f"{where}: {key}: found {found!r}; a list of {width} is needed")
    return found


def find_recordings(folder: Path) -> list[Path]:
    """Return the files of a folder that may be recordings, sorted by name.

    Raises RecordingError: the folder does not exist or has no such file.
    """
    if not folder.is_dir():
        raise RecordingError(f"{folder}: found no such folder")
    found = sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES)
    if not found:
        raise RecordingError(f"{folder}: found no flights; files with {' or '.join(SUFFIXES)} are read")
    return found


def read_recording(path: Path, columns: Mapping[str, Group]) -> Recording:
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
    for name, group in columns.items():
        missing = [column for column in group.columns if column not in names]
        if missing and QUANTITIES[name].required:
            raise RecordingError(
                f"columns of {name} not found: {', '.join(missing)}; the file has "
                f"{', '.join(names[:8])}, ...; name its columns by --columns"
            )
        double = [column for column in group.columns if names.count(column) > 1]
        if double:
            raise RecordingError(f"columns of {name} are there several times: {', '.join(double)}")
        if not missing:
            arrays[QUANTITIES[name].field] = _numbers(table, group)
    if len(arrays["time_s"]) < SAMPLES_MIN:
        raise RecordingError(f"found {len(arrays['time_s'])} samples, at least {SAMPLES_MIN} are needed")
    return _recording(path.stem, arrays)


def _numbers(table: pa.Table, group: Group) -> Floats:
    try:
        made = [
            factor * np.asarray(table[column].to_numpy(), dtype=np.float64)
            for column, factor in zip(group.columns, group.factors, strict=True)
        ]
    except (ValueError, TypeError, pa.ArrowException) as error:
        raise RecordingError(f"columns {', '.join(group.columns)} are not numbers: {error}") from error
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
