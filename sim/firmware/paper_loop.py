"""The paper's velocity controller, eq. 8: tau_p = -K_v (v - u*) + m G, and geometric attitude control.

The stock Mellinger controller refuses velocity set-points, so that this law is what must have run beside it.
It knows the nominal mass and the nominal thrust scale, not this vehicle's. At the paper's K_v = 0.5 N s/m on
32 g the velocity gain is 16 1/s against about 8 1/s of attitude bandwidth: the loop is under-damped by
design.

Not in the paper: the desired force keeps an upward share and a tilt limit. Without them a downward step of
0.63 m/s asks for no thrust and a larger one for flying upside down.
"""

from __future__ import annotations

import math

from sim.firmware.attitude import Axes, Counts, MellingerAttitude
from sim.firmware.setpoint import SensedState, Setpoint
from sim.params import Params

K_V_N_S_M = 0.5  # paper V: K_v = 0.5 I
UP_SHARE_MIN = 0.2  # of the weight
TAN_TILT_MAX = math.tan(
    math.radians(40.0)
)  # the thrust still carries the weight up to acos(1 / 1.53) = 49 degrees


class PaperLoop:
    """Velocity set-point in, thrust counts (per motor) and moment counts out; call at 500 Hz."""

    def __init__(self, params: Params) -> None:
        self._weight = params.body.mass_kg * params.contact.gravity_m_s2
        self._counts_per_n = 65535.0 / (4.0 * params.rotor.thrust_max_n)
        self._attitude = MellingerAttitude()

    def reset(self) -> None:
        """Forget integrals."""
        self._attitude.reset()

    def trim(self, force: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the set-point at which the loop, at rest, asks for ``force`` (world, N)."""
        return (force[0] / K_V_N_S_M, force[1] / K_V_N_S_M, (force[2] - self._weight) / K_V_N_S_M)

    def update(self, sensed: SensedState, setpoint: Setpoint, level: bool) -> tuple[float, Counts]:
        """Return ``(thrust counts per motor, moment counts)``; ``level`` keeps roll and pitch at zero."""
        vx, vy, vz = sensed.velocity
        weight = self._weight
        fz = max(UP_SHARE_MIN * weight, K_V_N_S_M * (setpoint.vz - vz) + weight)
        if level:
            fx = fy = 0.0
        else:
            fx, fy = K_V_N_S_M * (setpoint.vx - vx), K_V_N_S_M * (setpoint.vy - vy)
            side, most = math.sqrt(fx * fx + fy * fy), TAN_TILT_MAX * fz
            if side > most:
                fx, fy = fx * most / side, fy * most / side
        axes = sensed.axes
        thrust = fx * axes[6] + fy * axes[7] + fz * axes[8]
        desired = axes_from_force(fx, fy, fz, setpoint.cos_yaw, setpoint.sin_yaw)
        counts = thrust * self._counts_per_n
        wx, wy, wz = sensed.rates
        moments = self._attitude.update(axes, desired, wx, wy, wz)
        if counts <= 0.0:  # controller_mellinger.c: no thrust, no moments, integrals gone
            self.reset()
            return 0.0, (0, 0, 0)
        return counts, moments


def axes_from_force(fx: float, fy: float, fz: float, cos_yaw: float, sin_yaw: float) -> Axes:
    """Body axes with z along the force and x towards the yaw (controller_mellinger.c)."""
    scale = 1.0 / math.sqrt(fx * fx + fy * fy + fz * fz)
    zx, zy, zz = fx * scale, fy * scale, fz * scale
    yx, yy, yz = -zz * sin_yaw, zz * cos_yaw, zx * sin_yaw - zy * cos_yaw
    scale = 1.0 / math.sqrt(yx * yx + yy * yy + yz * yz)
    yx, yy, yz = yx * scale, yy * scale, yz * scale
    return (yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx, yx, yy, yz, zx, zy, zz)
