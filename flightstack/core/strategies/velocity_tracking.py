"""From the velocity wanted to the set-point that makes a lagging velocity loop fly it.

The loop on board answers a set-point like a second-order low-pass: late, the paper's weakness, and wind, drag
and a wrong weight push it off. How that is mended on one axis says ``velocity_axis.py``. The disturbance is
clamped, as no model is perfect.
"""

from __future__ import annotations

import math

from flightstack.core.memory import TrackingMemory
from flightstack.core.parameters.robust import VelocityFeedback, VelocityLoop
from flightstack.core.strategies.velocity_axis import axes
from flightstack.core.types import ZERO, Vec3


class VelocityTracking:
    """The corrections; call ``observe`` once a tick and ``command`` when a set-point goes out.

    Args:
        loop: the vehicle's velocity loop.
        period_s: of a tick.
        feedback: of its state, if asked for.
        delay_s: age of a velocity that is measured.
    """

    def __init__(
        self,
        loop: VelocityLoop,
        period_s: float,
        feedback: VelocityFeedback | None = None,
        delay_s: float = 0.0,
    ) -> None:
        self.memory = TrackingMemory()
        self._axes = axes(loop, feedback or VelocityFeedback(), delay_s, period_s)

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
        x, y, z = self._axes  # written out: a loop over three axes costs twice as much
        mx, dmx, dx = x.observe(v[0], u[0], m[0], dm[0], d[0])
        my, dmy, dy = y.observe(v[1], u[1], m[1], dm[1], d[1])
        mz, dmz, dz = z.observe(v[2], u[2], m[2], dm[2], d[2])
        memory.model_m_s, memory.model_m_s2 = (mx, my, mz), (dmx, dmy, dmz)
        memory.disturbance_m_s = (dx, dy, dz)

    def command(
        self,
        before_m_s: Vec3,
        reference_m_s: Vec3,
        velocity_m_s: Vec3,
        most_m_s: Vec3,
        least_z_m_s: float = -math.inf,
    ) -> Vec3:
        """Set-point that makes the vehicle fly the reference.

        Args:
            before_m_s: reference the present one was reached from within a tick.
            reference_m_s: velocity wanted now.
            velocity_m_s: measured now.
            most_m_s: bound of the set-point on each axis.
            least_z_m_s: lowest vertical velocity that the set-point may lead to if it stays the last one: the
                set-point itself and the disturbance that was learned.
        """
        memory, (x, y, z) = self.memory, self._axes
        b, r, v, s = before_m_s, reference_m_s, velocity_m_s, memory.slope_m_s2
        m, dm, d = memory.model_m_s, memory.model_m_s2, memory.disturbance_m_s
        sx, ux = x.command(b[0], r[0], v[0], s[0], m[0], dm[0], d[0], most_m_s[0])
        sy, uy = y.command(b[1], r[1], v[1], s[1], m[1], dm[1], d[1], most_m_s[1])
        sz, uz = z.command(b[2], r[2], v[2], s[2], m[2], dm[2], d[2], most_m_s[2])
        uz = min(max(uz, least_z_m_s - d[2]), most_m_s[2])
        memory.slope_m_s2, memory.setpoint_m_s = (sx, sy, sz), (ux, uy, uz)
        return memory.setpoint_m_s
