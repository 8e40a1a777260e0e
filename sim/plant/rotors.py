"""Four rotors: lag, thrust, drag torque, reaction and gyroscopic torque, ground effect, battery.

Body frame FLU. M1 front right turns counter-clockwise, M2 rear right clockwise, M3 rear left
counter-clockwise, M4 front left clockwise (seen from above; firmware power_distribution_quadrotor.c). A
counter-clockwise rotor turns the body clockwise, which is a negative yaw torque.

With MIX_YAW_i = -1 for counter-clockwise rotors, the rotors' angular momentum is h_z = -I_p sum(MIX_YAW_i
w_i), and the body feels -dh/dt - w x h.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sim.compiled.jit import jitted
from sim.compiled.records import F64, Motors, Record, new
from sim.plant.params import Plant, Rotor

Four = tuple[float, float, float, float]

RAD_S_PER_RPM = 2.0 * math.pi / 60.0
POSITION_X = (1, -1, -1, 1)  # sign of a rotor's x, M1..M4
POSITION_Y = (-1, -1, 1, 1)
MIX_YAW = (-1, 1, -1, 1)
ALWAYS_POSITIVE_RPM = 3000.0  # the fitted parabola of the thrust dips below zero under this speed


class RotorRecord(Record):
    """Rotor speeds and the wrench they make."""

    rpm: Motors
    thrust_n: float  # sum of the thrusts, along body z
    torque_x: float  # on the body, N m
    torque_y: float
    torque_z: float
    cushion: Motors  # factors of the ground effect on the thrusts
    p1: float  # thrust = (p1 + p2 rpm) rpm, N
    p2: float
    q1: float  # drag torque = (q1 + q2 rpm) rpm, N m
    q2: float
    arm: float
    gyro: float  # angular momentum per rpm
    reaction: float  # torque per change of speed in a step
    gain: float  # of the first-order lag, exact for a held command
    slow_rise: float
    slow_fall: float
    slow: bool


@jitted
def turn_rotors(r: RotorRecord, command: F64, wx: float, wy: float) -> None:
    """Advance the speeds towards ``command`` (rpm) by one step and compute the wrench.

    Args:
        r: changed in place; its ``cushion`` is what the ground effect does to the thrusts.
        command: commanded speeds, rpm.
        wx: body roll rate, rad/s.
        wy: body pitch rate, rad/s.
    """
    r1, r2, r3, r4 = r.rpm[0], r.rpm[1], r.rpm[2], r.rpm[3]
    c1, c2, c3, c4 = command[0], command[1], command[2], command[3]
    d1, d2, d3, d4 = c1 - r1, c2 - r2, c3 - r3, c4 - r4
    if r.slow:  # falling: d rpm/dt = k (c^2 - r^2), linearly implicit, second order; rising: exact
        d1 *= r.slow_rise if d1 > 0.0 else r.slow_fall * (c1 + r1) / (1.0 + r.slow_fall * r1)
        d2 *= r.slow_rise if d2 > 0.0 else r.slow_fall * (c2 + r2) / (1.0 + r.slow_fall * r2)
        d3 *= r.slow_rise if d3 > 0.0 else r.slow_fall * (c3 + r3) / (1.0 + r.slow_fall * r3)
        d4 *= r.slow_rise if d4 > 0.0 else r.slow_fall * (c4 + r4) / (1.0 + r.slow_fall * r4)
    else:
        d1, d2, d3, d4 = r.gain * d1, r.gain * d2, r.gain * d3, r.gain * d4
    r1, r2, r3, r4 = r1 + d1, r2 + d2, r3 + d3, r4 + d4
    r.rpm[0], r.rpm[1], r.rpm[2], r.rpm[3] = r1, r2, r3, r4
    p1, p2, q1, q2 = r.p1, r.p2, r.q1, r.q2
    t1, t2, t3, t4 = (p1 + p2 * r1) * r1, (p1 + p2 * r2) * r2, (p1 + p2 * r3) * r3, (p1 + p2 * r4) * r4
    if min(r1, r2, r3, r4) < ALWAYS_POSITIVE_RPM:
        t1, t2, t3, t4 = max(t1, 0.0), max(t2, 0.0), max(t3, 0.0), max(t4, 0.0)
    f = r.cushion
    t1, t2, t3, t4 = f[0] * t1, f[1] * t2, f[2] * t3, f[3] * t4
    spin = r.gyro * (r2 + r4 - r1 - r3)  # I_p sum(MIX_YAW_i w_i) = -h_z
    r.thrust_n = t1 + t2 + t3 + t4
    r.torque_x = r.arm * (t3 + t4 - t1 - t2) + wy * spin
    r.torque_y = r.arm * (t2 + t3 - t1 - t4) - wx * spin
    r.torque_z = (
        (q1 + q2 * r2) * r2 + (q1 + q2 * r4) * r4 - (q1 + q2 * r1) * r1 - (q1 + q2 * r3) * r3
    ) + r.reaction * (d2 + d4 - d1 - d3)


class Rotors:
    """Rotor speeds and the wrench they make.

    Args:
        rotor: static maps, lag, geometry.
        plant: factors on thrust (and with it torque) and on the lag.
        slow: the slow, asymmetric lag instead of the first-order one.
        step_s: time between calls of ``step``.
        record: where to keep everything; None for a place of its own.
    """

    __slots__ = ("_rpm", "record")

    def __init__(
        self, rotor: Rotor, plant: Plant, slow: bool, step_s: float, record: RotorRecord | None = None
    ) -> None:
        self.record = r = new(RotorRecord) if record is None else record
        self._rpm = r.rpm
        r.p1 = rotor.thrust_linear_n_rpm * plant.thrust
        r.p2 = rotor.thrust_square_n_rpm2 * plant.thrust
        r.q1 = rotor.torque_linear_n_m_rpm * plant.thrust
        r.q2 = rotor.torque_square_n_m_rpm2 * plant.thrust
        r.arm = rotor.arm_m
        r.gyro = rotor.inertia_kg_m2 * RAD_S_PER_RPM
        r.reaction = r.gyro / step_s
        r.gain = -math.expm1(-step_s / (rotor.lag_s * plant.motor_lag))
        r.slow_rise = -math.expm1(-step_s * rotor.slow_rise_1_s / plant.motor_lag)
        r.slow_fall = step_s * rotor.slow_fall_1_rpm_s / plant.motor_lag
        r.slow = slow
        r.cushion[:] = 1.0

    def step(self, command: Four, factors: Four | None, wx: float, wy: float) -> None:
        """Do ``turn_rotors`` with these ground-effect factors, None for none."""
        self.record.cushion[:] = factors or 1.0
        turn_rotors(self.record, np.array(command), wx, wy)

    @property
    def rpm(self) -> Four:
        """Speeds of M1..M4."""
        m1, m2, m3, m4 = self._rpm.tolist()
        return (m1, m2, m3, m4)

    @rpm.setter
    def rpm(self, rpm: Sequence[float]) -> None:
        self._rpm[:] = rpm

    @property
    def thrust_n(self) -> float:
        """Sum of the thrusts, along body z."""
        return float(self.record.thrust_n)

    @property
    def torque_x(self) -> float:
        """Roll torque on the body, N m."""
        return float(self.record.torque_x)

    @property
    def torque_y(self) -> float:
        """Pitch torque on the body, N m."""
        return float(self.record.torque_y)

    @property
    def torque_z(self) -> float:
        """Yaw torque on the body, N m."""
        return float(self.record.torque_z)
