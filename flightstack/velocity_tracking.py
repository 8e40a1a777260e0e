"""From the velocity wanted to the set-point that makes a lagging velocity loop fly it.

The loop on board answers a set-point u like a second-order low-pass, v = M(u) + disturbance. Its slow part is
a lag, the paper's weakness. Three corrections are added to the wanted velocity r (method of internal model
control, with a lead instead of the inverse model):

    u = r + lag * dr/dt + k (r - v) - d,      d = low-pass of (v - M(u))

``d`` collects what is constant: wind, drag, a wrong weight. With a perfect model it feeds nothing back, so it
cannot destabilise; it is clamped, as the model is not perfect.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.memory import TrackingMemory
from flightstack.robust_config import VelocityLoop
from flightstack.types import ZERO, Vec3


class _Axis(NamedTuple):
    """The velocity loop on board along one axis, and how hard it is helped."""

    lag_s: float  # group delay at low frequency
    rate_1_s: float  # natural frequency of the second-order model
    gain: float  # k above
    error_max_m_s: float  # of set-point against velocity: a loop that tilts hard loses lift


class VelocityTracking:
    """The corrections; call ``observe`` once a tick and ``command`` when a set-point goes out.

    Args:
        loop: the vehicle's velocity loop.
        period_s: of a tick.
    """

    def __init__(self, loop: VelocityLoop, period_s: float) -> None:
        self.memory = TrackingMemory()
        horizontal = _Axis(loop.lag_xy_s, loop.rate_xy_1_s, loop.gain_xy, loop.error_max_m_s)
        self._axes = (horizontal, horizontal, _Axis(loop.lag_z_s, loop.rate_z_1_s, loop.gain_z, math.inf))
        self._damping, self._most_m_s = loop.damping, loop.disturbance_max_m_s
        self._period_s = period_s
        self._slope_share = min(1.0, period_s / loop.slope_time_s)
        self._disturbance_share = min(1.0, period_s / loop.disturbance_time_s)

    def observe(self, velocity_enu_m_s: Vec3, *, commanding: bool) -> None:
        """Compare the velocity with what the model expects of the last set-point.

        Args:
            velocity_enu_m_s: measured now.
            commanding: the last set-point was flown; if not, the model follows the measurement.
        """
        memory, t, most_m_s = self.memory, self._period_s, self._most_m_s
        if not commanding:
            memory.model_m_s, memory.model_m_s2, memory.slope_m_s2 = velocity_enu_m_s, ZERO, ZERO
            return
        model, rate, found = [], [], []
        for axis, v, u, m, dm, d in zip(
            self._axes, velocity_enu_m_s, memory.setpoint_m_s, memory.model_m_s, memory.model_m_s2,
            memory.disturbance_m_s, strict=True,
        ):  # fmt: skip
            w = axis.rate_1_s
            dm_ = dm + t * (w * w * (u - m) - 2.0 * self._damping * w * dm)
            m_ = m + t * dm_
            d_ = d + self._disturbance_share * (v - m_ - d)
            model.append(m_)
            rate.append(dm_)
            found.append(max(-most_m_s, min(most_m_s, d_)))
        memory.model_m_s = (model[0], model[1], model[2])
        memory.model_m_s2 = (rate[0], rate[1], rate[2])
        memory.disturbance_m_s = (found[0], found[1], found[2])

    def command(self, before_m_s: Vec3, reference_m_s: Vec3, velocity_m_s: Vec3, most_m_s: Vec3) -> Vec3:
        """Set-point that makes the vehicle fly the reference.

        Args:
            before_m_s: reference the present one was reached from within a tick.
            reference_m_s: velocity wanted now.
            velocity_m_s: measured now.
            most_m_s: bound of the set-point on each axis.
        """
        memory, t = self.memory, self._period_s
        slope, out = [], []
        for axis, b, r, v, s, d, most in zip(
            self._axes, before_m_s, reference_m_s, velocity_m_s, memory.slope_m_s2, memory.disturbance_m_s,
            most_m_s, strict=True,
        ):  # fmt: skip
            s_ = s + self._slope_share * ((r - b) / t - s)
            u = r + axis.lag_s * s_ + axis.gain * (r - v) - d
            u = max(v - axis.error_max_m_s, min(v + axis.error_max_m_s, u))
            slope.append(s_)
            out.append(max(-most, min(most, u)))
        memory.slope_m_s2 = (slope[0], slope[1], slope[2])
        memory.setpoint_m_s = (out[0], out[1], out[2])
        return memory.setpoint_m_s
