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
from flightstack.position_loop import clip
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
        memory = self.memory
        if not commanding:
            memory.model_m_s, memory.model_m_s2, memory.slope_m_s2 = velocity_enu_m_s, ZERO, ZERO
            return
        v, u, m, dm, d = (
            velocity_enu_m_s, memory.setpoint_m_s, memory.model_m_s, memory.model_m_s2, memory.disturbance_m_s
        )  # fmt: skip
        step, (x, y, z) = self._observe, self._axes  # written out: a loop over three axes costs twice as much
        mx, dmx, dx = step(x, v[0], u[0], m[0], dm[0], d[0])
        my, dmy, dy = step(y, v[1], u[1], m[1], dm[1], d[1])
        mz, dmz, dz = step(z, v[2], u[2], m[2], dm[2], d[2])
        memory.model_m_s, memory.model_m_s2 = (mx, my, mz), (dmx, dmy, dmz)
        memory.disturbance_m_s = (dx, dy, dz)

    def _observe(
        self, axis: _Axis, v: float, u: float, m: float, dm: float, d: float
    ) -> tuple[float, float, float]:
        """Velocity by the model, its derivative, and the disturbance, of one axis."""
        t, w, most_m_s = self._period_s, axis.rate_1_s, self._most_m_s
        dm += t * (w * w * (u - m) - 2.0 * self._damping * w * dm)
        m += t * dm
        d += self._disturbance_share * (v - m - d)
        return m, dm, clip(d, -most_m_s, most_m_s)

    def command(self, before_m_s: Vec3, reference_m_s: Vec3, velocity_m_s: Vec3, most_m_s: Vec3) -> Vec3:
        """Set-point that makes the vehicle fly the reference.

        Args:
            before_m_s: reference the present one was reached from within a tick.
            reference_m_s: velocity wanted now.
            velocity_m_s: measured now.
            most_m_s: bound of the set-point on each axis.
        """
        memory, (x, y, z), step = self.memory, self._axes, self._command
        b, r, v, s, d = before_m_s, reference_m_s, velocity_m_s, memory.slope_m_s2, memory.disturbance_m_s
        sx, ux = step(x, b[0], r[0], v[0], s[0], d[0], most_m_s[0])
        sy, uy = step(y, b[1], r[1], v[1], s[1], d[1], most_m_s[1])
        sz, uz = step(z, b[2], r[2], v[2], s[2], d[2], most_m_s[2])
        memory.slope_m_s2, memory.setpoint_m_s = (sx, sy, sz), (ux, uy, uz)
        return memory.setpoint_m_s

    def _command(
        self, axis: _Axis, b: float, r: float, v: float, s: float, d: float, most: float
    ) -> tuple[float, float]:
        """Smoothed derivative of the velocity wanted, and set-point, of one axis."""
        s += self._slope_share * ((r - b) / self._period_s - s)
        u = r + axis.lag_s * s + axis.gain * (r - v) - d
        return s, clip(clip(u, v - axis.error_max_m_s, v + axis.error_max_m_s), -most, most)
