"""Published numbers for comparison with the simulated vehicle, and results derived from them by hand."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sim.firmware.geometric import K_V_N_S_M
from tests.linear_analysis import MASS, PARAMS, G

F64 = npt.NDArray[np.float64]
ROTOR = PARAMS.rotor

# Bitcraze 2015, propeller bench (crazyflie-firmware docs/functional-areas/pwm-to-thrust.md): all four motors
BENCH = (  # mass, g; rotor speed, rpm; duty cycle; battery, V
    (28.6, 17174.0, 0.5625, 3.67),
    (57.9, 23882.0, 0.9375, 3.30),
)
BENCH_FIT = (1.0942e-7, -2.1059e-4, 0.15417)  # polynomial of the thrust, g, in rpm (page of ``BENCH``)
BENCH_STEP_S = 0.180  # rise time from standstill to 25000 rpm (Bitcraze blog)
FOERSTER_LAG_S = 0.002 / -math.log(0.9695404)  # motor lag from the discrete pole at 500 Hz (Foerster 2015)
ESCHMANN_LAG_S = 0.072  # motor lag after Eschmann, quoted in rotorpy 3.0.0, crazyflie_params.py
L250_RISE_S, L250_FALL_S = 0.136, 0.108  # drone-models 0.1.0, params.toml: reciprocal of its rates, at hover
L250_HOVER_RPM, L250_HOVER_COUNTS = 18968.0, 42700.0  # L250 thrust curve at 31.9 g; motor command
DATA_SHEET_HOVER_S = 7.0 * 60.0  # flight time in the data sheet of the Crazyflie 2.0 (Bitcraze)


def bench_rpm(grams: float) -> float:
    """Return the rotor speed at which Bitcraze's bench fit gives this total thrust of four rotors."""
    a, b, c = BENCH_FIT
    return (-b + math.sqrt(b * b - 4.0 * a * (c - grams))) / (2.0 * a)


def cheeseman_bennett(height: F64, radius: float = ROTOR.radius_m) -> F64:
    """Return the thrust ratio T/T0 of one rotor in ground effect (Cheeseman and Bennett 1955)."""
    return 1.0 / (1.0 - (radius / (4.0 * height)) ** 2)


def pybullet_drones(height: F64) -> F64:
    """Return the thrust ratio T/T0 in ground effect of gym-pybullet-drones (BaseAviary.py), above 37.8 mm."""
    return 1.0 + 11.36859 * (0.0231348 / (4.0 * np.maximum(height, 0.0378))) ** 2


def sanchez_cuevas(height: F64, body_lift: float, radius: float = ROTOR.radius_m) -> F64:
    """Return the thrust ratio T/T0 of a quadrotor (Sanchez-Cuevas 2017): rotors 65 mm apart, diagonal 92 mm.

    ``body_lift``: K_b of the fountain below the body: 2 in the publication, not identified for so small a
    vehicle.
    """
    z, d, b = height, 0.065, 0.092
    r2 = radius * radius
    loss = (radius / (4.0 * z)) ** 2
    loss = loss + r2 * z / np.sqrt((d * d + 4.0 * z * z) ** 3)
    loss = loss + 0.5 * r2 * z / np.sqrt((2.0 * d * d + 4.0 * z * z) ** 3)
    loss = loss + 2.0 * r2 * z * body_lift / np.sqrt((b * b + 4.0 * z * z) ** 3)
    return 1.0 / (1.0 - loss)


def descend(
    height_m: float, speed_m_s: float, *, motors_off: bool, step_s: float = 1e-4
) -> tuple[float, float]:
    """Simulate the descent of a point mass with rotors; return time and speed of the first touch.

    The motion is vertical, without sensors: paper's velocity law, rotor lag, thrust, ground effect, drag.
    ``motors_off``: the motors are off from the start, so there is no commanded descent.
    """
    p1, p2 = ROTOR.thrust_linear_n_rpm, ROTOR.thrust_square_n_rpm2
    plane = ROTOR.above_com_m - PARAMS.geometry.foot_bottom_m  # height of the rotors above the feet
    drag, weight = PARAMS.body.drag_n_s_m[2], MASS * G
    z, v, t = height_m, -speed_m_s, 0.0
    wanted = -speed_m_s * (1.0 + drag / K_V_N_S_M) if motors_off else -speed_m_s
    rpm = ROTOR.rpm((weight - drag * speed_m_s) / 4.0)
    while z > 0.0:
        force = max(0.2 * weight, K_V_N_S_M * (wanted - v) + weight)
        command = 0.0 if motors_off else ROTOR.rpm(force / 4.0)
        rpm += (command - rpm) * step_s / ROTOR.lag_s
        ratio = ROTOR.radius_m / (4.0 * max(z + plane, 0.02))
        thrust = 4.0 * max(0.0, (p1 + p2 * rpm) * rpm) / (1.0 - ratio * ratio)
        v += ((thrust - drag * v) / MASS - G) * step_s
        z += v * step_s
        t += step_s
    return t, -v
