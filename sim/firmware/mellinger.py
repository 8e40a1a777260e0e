"""The Crazyflie's Mellinger controller with its default gains: position set-points to thrust and moments.

    F = m a + kp e + kd de/dt + ki int(e),   e = set-point minus estimate, thrust = F along body z

It follows firmware controller_mellinger.c of release 2025.12 (attitude: ``sim.firmware.paper_loop``) and
accepts only position set-points. As in the firmware, the integrals are bounded (a vehicle heavier than
``MASS_KG`` stays below its set-point) and grow while the set-point is out of reach. Zero thrust sets the
moments to zero and resets the integrals. When the supervisor levels out, the height of the newest set-point
is held.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record, Vector, new
from sim.firmware.paper_loop import AttitudeRecord, Counts, attitude_moments, axes_from_force
from sim.firmware.setpoint import SensedState, SetpointRecord
from sim.plant.params import CONTROL_STEP_S
from sim.plant.rotation import nine

MASS_KG = 0.029  # platform_defaults_cf2.h: CF_MASS; agrees with the hover thrust of recorded flights
MASS_THRUST = 132000.0  # thrust counts per newton: massThrust
GRAVITY_M_S2 = 9.81  # value in the firmware's physicalConstants.h
KP_XY, KD_XY, KI_XY = 0.4, 0.2, 0.05  # horizontal gains, N/m, N s/m, N/(m s)
KP_Z, KD_Z, KI_Z = 1.25, 0.4, 0.05
I_RANGE_XY, I_RANGE_Z = 2.0, 0.4  # limits of the integrals, m s
K_R_Z, K_W_Z = 60000.0, 12000.0  # yaw gains kR_z, kw_z; roll and pitch gains: ``sim.firmware.paper_loop``


class MellingerRecord(Record):
    integral: Vector  # integral of the position error, m s
    attitude: AttitudeRecord


@jitted
def mellinger_update(
    m: MellingerRecord, sensed: SensedState, setpoint: SetpointRecord, level: bool
) -> tuple[float, Counts]:
    """Return ``(thrust counts per motor, moment counts)``; ``level``: command zero roll and pitch."""
    p, v, i = sensed.position, sensed.velocity, m.integral
    ex, ey, ez = setpoint.x - p[0], setpoint.y - p[1], setpoint.z - p[2]
    i[0] = max(-I_RANGE_XY, min(I_RANGE_XY, i[0] + ex * CONTROL_STEP_S))
    i[1] = max(-I_RANGE_XY, min(I_RANGE_XY, i[1] + ey * CONTROL_STEP_S))
    i[2] = max(-I_RANGE_Z, min(I_RANGE_Z, i[2] + ez * CONTROL_STEP_S))
    fx = fy = 0.0
    fz = MASS_KG * GRAVITY_M_S2 + KP_Z * ez + KD_Z * (setpoint.vz - v[2]) + KI_Z * i[2]
    if not level:
        fx = KP_XY * ex + KD_XY * (setpoint.vx - v[0]) + KI_XY * i[0]
        fy = KP_XY * ey + KD_XY * (setpoint.vy - v[1]) + KI_XY * i[1]
    axes = nine(sensed.axes)
    counts = (fx * axes[6] + fy * axes[7] + fz * axes[8]) * MASS_THRUST
    desired = axes_from_force(fx, fy, fz, setpoint.cos_yaw, setpoint.sin_yaw)
    rates = sensed.rates
    moments = attitude_moments(m.attitude, axes, desired, rates[0], rates[1], rates[2])
    if counts <= 0.0:
        mellinger_reset(m)
        return 0.0, (0, 0, 0)
    return counts, moments


@jitted
def mellinger_reset(m: MellingerRecord) -> None:
    m.integral[:] = 0.0
    m.attitude.integral_z = 0.0


class MellingerLoop:
    def __init__(self, record: MellingerRecord | None = None) -> None:
        self.record = r = new(MellingerRecord) if record is None else record
        r.attitude.wx = math.nan
        r.attitude.k_r_z, r.attitude.k_w_z = K_R_Z, K_W_Z

    def reset(self) -> None:
        mellinger_reset(self.record)
