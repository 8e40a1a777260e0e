"""Linear models of the PID loops; ``tests.linear_analysis`` has those of the paper's loop.

x' = A x + b u with the set-point u, linearised at hover, continuous in time; the first state is the
controlled one. The models include the IMU's filters, which delay gyro rates, the roll integrated from them,
and vertical velocity (horizontal velocity comes from the tilt). They omit integer counts, limits, sampling at
500 and 100 Hz, corrections of the estimate, and delays. Gains are from platform_defaults_cf2.h.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.linear_analysis import MASS, N_PER_COUNT, PARAMS, TORQUE_PER_COUNT, G, held

F64 = npt.NDArray[np.float64]

DEG = 180.0 / math.pi
GYRO_S = 1.0 / (math.sqrt(2.0) * math.pi * PARAMS.imu.gyro_filter_hz)  # group delay of a second-order filter
ACCEL_S = 1.0 / (math.sqrt(2.0) * math.pi * PARAMS.imu.accel_filter_hz)


@dataclass(frozen=True)
class Linear:
    """x' = a x + b u."""

    a: F64
    b: F64

    def response(self, steps: int, start: float = 0.0, wanted: float = 1.0) -> F64:
        """Return the first state, initially ``start``, after each step of 2 ms under a constant input."""
        step, drive = held(self.a, self.b)
        x = np.zeros(len(self.a))
        x[0] = start
        out = []
        for _ in range(steps):
            x = step @ x + drive * wanted
            out.append(x[0])
        return np.array(out)


def assemble(names: str, rates: Callable[..., dict[str, float]]) -> Linear:
    """Build a model from functions, linear in states and input ``u``, by their values at unit vectors."""
    states = names.split()
    columns = []
    for one in [*states, "u"]:
        change = rates(**{name: float(name == one) for name in [*states, "u"]})
        columns.append([change[name] for name in states])
    matrix = np.array(columns).T
    return Linear(matrix[:, :-1], matrix[:, -1])


def _turning(
    wanted: float,
    phi: float,
    p: float,
    torque: float,
    gyro: float,
    i_angle: float,
    i_rate: float,
    lag_s: float,
) -> dict[str, float]:
    """Return the model of roll: rate and rotor torque, true and measured, and both integrals; degrees."""
    error = DEG * (wanted - (phi - GYRO_S * gyro))  # the angle is integrated from the filtered rate
    rate_error = 6.0 * error + 3.0 * i_angle - DEG * gyro
    gyro_rate = (p - gyro) / GYRO_S
    counts = 250.0 * rate_error + 500.0 * i_rate - 2.5 * DEG * gyro_rate
    return {
        "phi": p,
        "p": torque / PARAMS.body.inertia_kg_m2[0],
        "torque": (TORQUE_PER_COUNT * counts - torque) / lag_s,
        "gyro": gyro_rate,
        "i_angle": error,
        "i_rate": rate_error,
    }


def roll(lag_s: float) -> Linear:
    """Return the model of roll under the set-point u."""

    def rates(u: float, **states: float) -> dict[str, float]:
        return _turning(u, lag_s=lag_s, **states)

    return assemble("phi p torque gyro i_angle i_rate", rates)


def horizontal(lag_s: float) -> Linear:
    """Return the model of horizontal velocity under the set-point u: velocity, attitude and motor loops."""
    drag_1_s = PARAMS.body.drag_n_s_m[0] / MASS

    def rates(v: float, i_v: float, u: float, **states: float) -> dict[str, float]:
        tilt = (25.0 * (u - v) + i_v) / DEG
        turning = _turning(tilt, lag_s=lag_s, **states)
        return {"v": G * states["phi"] - drag_1_s * v, "i_v": u - v, **turning}

    return assemble("v phi p torque gyro i_angle i_rate i_v", rates)


def vertical(lag_s: float) -> Linear:
    """Return the model of vertical velocity under the set-point u."""
    per_unit = 4.0 * N_PER_COUNT * 1000.0  # position_controller_pid.c: thrustScale
    drag = PARAMS.body.drag_n_s_m[2]

    def rates(v: float, thrust: float, felt: float, i_v: float, u: float) -> dict[str, float]:
        return {
            "v": (thrust - drag * v) / MASS,
            "thrust": (per_unit * (25.0 * (u - felt) + 15.0 * i_v) - thrust) / lag_s,
            "felt": (v - felt) / ACCEL_S,
            "i_v": u - felt,
        }

    return assemble("v thrust felt i_v", rates)
