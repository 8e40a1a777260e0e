"""The paper's velocity controller, and the geometric attitude control below it.

The velocity controller is eq. 8: tau_p = -K_v (v - u*) + m G. The stock Mellinger controller rejects
velocity set-points, so the paper must have added this control law. Mass and thrust scale in it are nominal,
not those of this vehicle. With the paper's K_v = 0.5 N s/m on 32 g the velocity gain is 16 1/s, but
the attitude bandwidth is only about 8 1/s: the loop is under-damped by design.

This module adds two limits to the paper: a minimum of the upward force, and a maximum tilt. Without them, a
downward step of 0.63 m/s commands zero thrust, and a larger step an inverted attitude.

The attitude part is that of the Crazyflie's Mellinger controller (firmware controller_mellinger.c), in FLU:

    M = -kR eR - kw w + ki int(-eR) - kd dw/dt,   eR = (Rd' R - R' Rd) as a vector

As in the firmware, eR lacks the factor 1/2 of the literature, so kR has twice the effect. The D-term
on roll and pitch rate is the raw difference at 500 Hz. It acts as inertia (200 counts equal 2.4e-5 kg m^2,
more than the body's inertia). Outputs are limited to 32000 counts and truncated to integers. The firmware
inverts pitch internally, which cancels in FLU moments.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record
from flightstack.core.types import Vec3
from sim.firmware.mixer import counts_per_n
from sim.firmware.setpoint import SensedState, SetpointRecord
from sim.plant.params import CONTROL_STEP_S, Params
from sim.plant.states import Nine, nine

# Paper V: K1 = diag(7, 7, 0.5)e4, K2 = diag(2, 2, 0.2)e4. The roll and pitch gains are the firmware's
# defaults; the firmware's yaw gains are 6e4 and 1.2e4.
K_R_XY = 70000.0  # counts per unit of eR
K_R_Z = 5000.0
K_W_XY = 20000.0  # counts per rad/s
K_W_Z = 2000.0
K_D_OMEGA_RP = 200.0  # counts per rad/s^2; firmware default, controller_mellinger.c: kd_omega_rp
K_I_Z = 500.0  # counts per (unit of eR) s; firmware default: ki_m_z
I_RANGE_Z = 1500.0  # limit of the yaw integral; firmware default: i_range_m_z
MOMENT_MAX = 32000.0  # limit of each moment, counts

Counts = tuple[int, int, int]  # moments about body x, y, z, counts


class PaperRecord(Record):
    """Constants of the paper's velocity loop, and state of its attitude controller."""

    weight: float  # nominal weight, N
    counts_per_n: float
    wx: float  # roll rate in the last call, rad/s; NaN before the first call
    wy: float
    integral_z: float


@jitted
def attitude_moments(p: PaperRecord, axes: Nine, desired: Nine, wx: float, wy: float, wz: float) -> Counts:
    """Return the moments at 500 Hz; ``axes``: estimate; ``wx``, ``wy``, ``wz``: gyro rates, rad/s."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
    dxx, dxy, dxz, dyx, dyy, dyz, dzx, dzy, dzz = desired
    ex = dzx * yx + dzy * yy + dzz * yz - (zx * dyx + zy * dyy + zz * dyz)
    ey = dxx * zx + dxy * zy + dxz * zz - (xx * dzx + xy * dzy + xz * dzz)
    ez = dyx * xx + dyy * xy + dyz * xz - (yx * dxx + yy * dxy + yz * dxz)
    if math.isnan(p.wx):
        p.wx, p.wy = wx, wy
    ax, ay = (wx - p.wx) / CONTROL_STEP_S, (wy - p.wy) / CONTROL_STEP_S
    p.wx, p.wy = wx, wy
    p.integral_z = max(-I_RANGE_Z, min(I_RANGE_Z, p.integral_z - ez * CONTROL_STEP_S))
    mx = -K_R_XY * ex - K_W_XY * wx - K_D_OMEGA_RP * ax
    my = -K_R_XY * ey - K_W_XY * wy - K_D_OMEGA_RP * ay
    mz = -K_R_Z * ez - K_W_Z * wz + K_I_Z * p.integral_z
    mx = max(-MOMENT_MAX, min(MOMENT_MAX, mx))
    my = max(-MOMENT_MAX, min(MOMENT_MAX, my))
    mz = max(-MOMENT_MAX, min(MOMENT_MAX, mz))
    return (int(mx), int(my), int(mz))


K_V_N_S_M = 0.5  # velocity gain, section V of the paper: K_v = 0.5 I
UP_SHARE_MIN = 0.2  # lower limit of the upward force, divided by the weight
TAN_TILT_MAX = math.tan(math.radians(40.0))  # tilt limit, 40 degrees; thrust suffices up to 49


@jitted
def axes_from_force(fx: float, fy: float, fz: float, cos_yaw: float, sin_yaw: float) -> Nine:
    """Return body axes with z along the force and x towards the yaw (controller_mellinger.c)."""
    scale = 1.0 / math.sqrt(fx * fx + fy * fy + fz * fz)
    zx, zy, zz = fx * scale, fy * scale, fz * scale
    yx, yy, yz = -zz * sin_yaw, zz * cos_yaw, zx * sin_yaw - zy * cos_yaw
    scale = 1.0 / math.sqrt(yx * yx + yy * yy + yz * yz)
    yx, yy, yz = yx * scale, yy * scale, yz * scale
    return (yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx, yx, yy, yz, zx, zy, zz)


@jitted
def paper_update(
    p: PaperRecord, sensed: SensedState, setpoint: SetpointRecord, level: bool
) -> tuple[float, Counts]:
    """Return ``(thrust counts per motor, moment counts)``; ``level``: command zero roll and pitch."""
    vx, vy, vz = sensed.velocity[0], sensed.velocity[1], sensed.velocity[2]
    fx = fy = 0.0
    fz = max(UP_SHARE_MIN * p.weight, K_V_N_S_M * (setpoint.vz - vz) + p.weight)
    if not level:
        fx, fy = K_V_N_S_M * (setpoint.vx - vx), K_V_N_S_M * (setpoint.vy - vy)
        side, most = math.sqrt(fx * fx + fy * fy), TAN_TILT_MAX * fz
        if side > most:
            fx, fy = fx * most / side, fy * most / side
    axes = nine(sensed.axes)
    counts = (fx * axes[6] + fy * axes[7] + fz * axes[8]) * p.counts_per_n
    desired = axes_from_force(fx, fy, fz, setpoint.cos_yaw, setpoint.sin_yaw)
    rates = sensed.rates
    moments = attitude_moments(p, axes, desired, rates[0], rates[1], rates[2])
    if counts <= 0.0:  # as in controller_mellinger.c, zero thrust gives no moments and resets the integrals
        paper_reset(p)
        return 0.0, (0, 0, 0)
    return counts, moments


@jitted
def paper_reset(p: PaperRecord) -> None:
    p.integral_z = 0.0


def set_up_paper(p: PaperRecord, params: Params) -> None:
    p.weight = weight_n = params.body.mass_kg * params.contact.gravity_m_s2
    p.counts_per_n = counts_per_n(params, weight_n)
    p.wx = math.nan


def paper_trim(p: PaperRecord, force: Vec3, counts_per_n: float) -> Vec3:
    """Return the velocity set-point, m/s, with which the loop commands ``force`` (world, N) at rest."""
    scale = counts_per_n / p.counts_per_n
    fx, fy, fz = scale * force[0], scale * force[1], scale * force[2]
    return (fx / K_V_N_S_M, fy / K_V_N_S_M, (fz - p.weight) / K_V_N_S_M)
