"""Attitude controller of the Crazyflie's Mellinger controller (firmware controller_mellinger.c), in FLU.

    M = -kR eR - kw w + ki int(-eR) - kd dw/dt,   eR = (Rd' R - R' Rd) as a vector

Quirks kept: eR without the 1/2 of the literature, so that kR counts twice on a small angle; a D-term on roll
and pitch rate as a raw difference at 500 Hz, which acts as inertia (200 counts make 2.4e-5 kg m^2, more than
the body's own); outputs clamped to 32000 counts and cut to whole counts.
The firmware's pitch has the other sign inside; in FLU moments nothing of that remains.
"""

from __future__ import annotations

import math

from sim.params import CONTROL_STEP_S

# paper V: K1 = diag(7, 7, 0.5)e4, K2 = diag(2, 2, 0.2)e4; the roll and pitch gains are the firmware's
# defaults
K_R_XY = 70000.0  # counts per unit of eR
K_R_Z = 5000.0
K_W_XY = 20000.0  # counts per rad/s
K_W_Z = 2000.0
K_D_OMEGA_RP = 200.0  # counts per rad/s^2; firmware default, controller_mellinger.c: kd_omega_rp
K_I_Z = 500.0  # counts per (unit of eR) s; firmware default: ki_m_z
I_RANGE_Z = 1500.0  # firmware default: i_range_m_z
MOMENT_MAX = 32000.0  # counts

Axes = tuple[float, ...]  # body x, y, z axis in the world, nine numbers
Counts = tuple[int, int, int]  # moments about body x, y, z


class MellingerAttitude:
    """Turns desired axes into moment counts; call at 500 Hz."""

    __slots__ = ("_integral_z", "_wx", "_wy")

    def __init__(self) -> None:
        self._wx: float | None = None
        self._wy = 0.0
        self._integral_z = 0.0

    def reset(self) -> None:
        """Forget the integral, as the firmware does at zero thrust."""
        self._integral_z = 0.0

    def update(self, axes: Axes, desired: Axes, wx: float, wy: float, wz: float) -> Counts:
        """Return the moments in counts.

        Args:
            axes: estimated body axes.
            desired: desired body axes.
            wx: roll rate by the gyro, FLU rad/s.
            wy: pitch rate.
            wz: yaw rate.
        """
        xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
        dxx, dxy, dxz, dyx, dyy, dyz, dzx, dzy, dzz = desired
        ex = dzx * yx + dzy * yy + dzz * yz - (zx * dyx + zy * dyy + zz * dyz)
        ey = dxx * zx + dxy * zy + dxz * zz - (xx * dzx + xy * dzy + xz * dzz)
        ez = dyx * xx + dyy * xy + dyz * xz - (yx * dxx + yy * dxy + yz * dxz)
        if self._wx is None:
            self._wx, self._wy = wx, wy
        ax, ay = (wx - self._wx) / CONTROL_STEP_S, (wy - self._wy) / CONTROL_STEP_S
        self._wx, self._wy = wx, wy
        integral = self._integral_z - ez * CONTROL_STEP_S
        if not -I_RANGE_Z < integral < I_RANGE_Z:
            integral = math.copysign(I_RANGE_Z, integral)
        self._integral_z = integral
        mx = -K_R_XY * ex - K_W_XY * wx - K_D_OMEGA_RP * ax
        my = -K_R_XY * ey - K_W_XY * wy - K_D_OMEGA_RP * ay
        mz = -K_R_Z * ez - K_W_Z * wz + K_I_Z * integral
        if not (
            -MOMENT_MAX < mx < MOMENT_MAX and -MOMENT_MAX < my < MOMENT_MAX and -MOMENT_MAX < mz < MOMENT_MAX
        ):
            mx = max(-MOMENT_MAX, min(MOMENT_MAX, mx))
            my = max(-MOMENT_MAX, min(MOMENT_MAX, my))
            mz = max(-MOMENT_MAX, min(MOMENT_MAX, mz))
        return (int(mx), int(my), int(mz))
