"""Attitude part of the Crazyflie's Mellinger controller (firmware controller_mellinger.c), in FLU.

    M = -kR eR - kw w + ki int(-eR) - kd dw/dt,   eR = (Rd' R - R' Rd) as a vector

The model follows the firmware: eR lacks the factor 1/2 of the literature, so kR counts twice at a small
angle. The D-term on roll and pitch rate is the raw difference at 500 Hz. It acts as inertia (200 counts equal
2.4e-5 kg m^2, more than the body's inertia). Outputs are limited to 32000 counts and truncated to integers.
The firmware inverts pitch internally, which cancels in FLU moments.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record
from sim.plant.params import CONTROL_STEP_S
from sim.plant.rotation import Nine

# Paper V: K1 = diag(7, 7, 0.5)e4, K2 = diag(2, 2, 0.2)e4. The roll and pitch gains are the firmware's
# defaults; ``sim.firmware.mellinger`` has the firmware's yaw gains.
K_R_XY = 70000.0  # counts per unit of eR
K_R_Z = 5000.0
K_W_XY = 20000.0  # counts per rad/s
K_W_Z = 2000.0
K_D_OMEGA_RP = 200.0  # counts per rad/s^2; firmware default, controller_mellinger.c: kd_omega_rp
K_I_Z = 500.0  # counts per (unit of eR) s; firmware default: ki_m_z
I_RANGE_Z = 1500.0  # firmware default: i_range_m_z
MOMENT_MAX = 32000.0  # limit of each moment, counts

Counts = tuple[int, int, int]  # moments about body x, y, z, counts


class AttitudeRecord(Record):
    wx: float  # roll rate at the last call, rad/s; NaN before the first call
    wy: float
    integral_z: float
    k_r_z: float  # yaw gains, counts per unit of eR and per rad/s
    k_w_z: float


@jitted
def attitude_moments(a: AttitudeRecord, axes: Nine, desired: Nine, wx: float, wy: float, wz: float) -> Counts:
    """Return the moments at 500 Hz; ``axes``: estimated; ``wx``, ``wy``, ``wz``: gyro rates, rad/s."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
    dxx, dxy, dxz, dyx, dyy, dyz, dzx, dzy, dzz = desired
    ex = dzx * yx + dzy * yy + dzz * yz - (zx * dyx + zy * dyy + zz * dyz)
    ey = dxx * zx + dxy * zy + dxz * zz - (xx * dzx + xy * dzy + xz * dzz)
    ez = dyx * xx + dyy * xy + dyz * xz - (yx * dxx + yy * dxy + yz * dxz)
    if math.isnan(a.wx):
        a.wx, a.wy = wx, wy
    ax, ay = (wx - a.wx) / CONTROL_STEP_S, (wy - a.wy) / CONTROL_STEP_S
    a.wx, a.wy = wx, wy
    a.integral_z = max(-I_RANGE_Z, min(I_RANGE_Z, a.integral_z - ez * CONTROL_STEP_S))
    mx = -K_R_XY * ex - K_W_XY * wx - K_D_OMEGA_RP * ax
    my = -K_R_XY * ey - K_W_XY * wy - K_D_OMEGA_RP * ay
    mz = -a.k_r_z * ez - a.k_w_z * wz + K_I_Z * a.integral_z
    mx = max(-MOMENT_MAX, min(MOMENT_MAX, mx))
    my = max(-MOMENT_MAX, min(MOMENT_MAX, my))
    mz = max(-MOMENT_MAX, min(MOMENT_MAX, mz))
    return (int(mx), int(my), int(mz))
