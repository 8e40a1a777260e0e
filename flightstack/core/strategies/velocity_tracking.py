"""Set-point with which a vehicle whose velocity loop lags follows a velocity command.

The velocity loop on board responds to a set-point u like a second-order low-pass M (natural frequency w,
damping zeta); the paper neglects this lag. Wind, drag and a wrong mass disturb the velocity v: v = M(u) + d.
Two corrections for one axis use this model (acceleration by the loop: a, by disturbance: f = w d / (2 zeta)):

    v' = a + f,      a' = w^2 (u - v) - 2 zeta w a

The lag compensation ("lead") adds corrections to the command r (internal model control, with a lead instead
of the inverse model). Its feedback is only k (r - v), k = gain_xy, and a slow d; a wrong model is tolerated:

    u = r + lag * r' + k (r - v) - d,      d = low-pass of (v - M(u))

The velocity feedback ("feedback") uses the whole state; an observer estimates the unmeasured part. This
correction rejects gusts sooner and does not oscillate, but needs the model of the vehicle's loop. The
acceleration a* corrects the velocity at the rate l, and the loop reaches a* at the rate m:

    a* = r' + l (r - v) - f,      a' = m (a* - a),      u = v + (2 zeta w a + m (a* - a)) / w^2

The disturbance is limited, because no model is perfect.

With a dead time, v is predicted to the time at which the set-point takes effect (a Smith predictor; see
docs/how_it_works/robust_filter.md, *Dead time*).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from flightstack.core.memory import LateMemory, TrackingMemory
from flightstack.core.numeric import rare
from flightstack.core.parameters.robust import VelocityFeedback, VelocityLoop
from flightstack.core.safety.position_loop import clip
from flightstack.core.types import ZERO, Vec3


def lead_observed(
    loop: VelocityLoop, t: float, v: float, u: float, m: float, dm: float, d: float
) -> tuple[float, float, float]:
    """Return the model's velocity, its derivative, and the disturbance after one tick of ``t`` seconds.

    The model uses only the set-point; the disturbance is the low-pass filtered error of the model's velocity.
    """
    w, most_m_s = loop.rate_xy_1_s, loop.disturbance_max_m_s
    dm += t * (w * w * (u - m) - 2.0 * loop.damping * w * dm)
    m += t * dm
    d += min(1.0, t / loop.disturbance_time_s) * (v - m - d)
    return m, dm, clip(d, -most_m_s, most_m_s)


def lead_commanded(
    loop: VelocityLoop, t: float, b: float, r: float, v: float, s: float, d: float, most: float
) -> tuple[float, float]:
    """Return the smoothed derivative of the velocity command, and the set-point."""
    s += min(1.0, t / loop.slope_time_s) * ((r - b) / t - s)
    u = r + loop.lag_xy_s * s + loop.gain_xy * (r - v) - d
    return s, clip(clip(u, v - loop.error_max_m_s, v + loop.error_max_m_s), -most, most)


def lead_carried(
    loop: VelocityLoop, t: float, v: float, m: float, dm: float, sent: Sequence[float]
) -> tuple[float, float]:
    """Return distance and velocity after the set-points ``sent`` (one per tick) have taken effect."""
    distance_m, now = 0.0, m
    for u in sent:
        m, dm, _ = lead_observed(loop, t, m, u, m, dm, 0.0)
        distance_m += t * (v + (m - now))
    return distance_m, v + (m - now)


def feedback_observed(
    loop: VelocityLoop, feedback: VelocityFeedback, delay_s: float, t: float, v: float, u: float, m: float,
    dm: float, d: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the results of ``lead_observed`` from an observer that the measured velocity corrects.

    The velocity is ``delay_s`` old and is extrapolated. ``observer_rate_1_s`` is the observer's double pole.
    """
    w, rate, most_m_s = loop.rate_xy_1_s, feedback.observer_rate_1_s, loop.disturbance_max_m_s
    push_1_s = w / (2.0 * loop.damping)  # ratio f / d, 1/s
    f = push_1_s * d
    now = v + delay_s * (dm + f)
    missed = v - m
    m += t * (dm + f + 2.0 * rate * missed)
    dm += t * (w * w * (u - now) - 2.0 * loop.damping * w * dm)
    d += t * (rate * rate / push_1_s) * missed
    return m, dm, clip(d, -most_m_s, most_m_s)


def feedback_commanded(
    loop: VelocityLoop, feedback: VelocityFeedback, delay_s: float, t: float, b: float, r: float, s: float,
    m: float, dm: float, d: float, most: float,
) -> tuple[float, float]:  # fmt: skip
    """Return the results of ``lead_commanded``, from the state of the model instead of the velocity."""
    w, most_m_s2 = loop.rate_xy_1_s, feedback.acceleration_max_m_s2
    f = w / (2.0 * loop.damping) * d
    s += min(1.0, t / loop.slope_time_s) * ((r - b) / t - s)
    now = m + delay_s * (dm + f)
    wanted = clip(s + feedback.error_rate_1_s * (r - now) - f, -most_m_s2, most_m_s2)
    u = now + (2.0 * loop.damping * w * dm + feedback.tilt_rate_1_s * (wanted - dm)) / (w * w)
    return s, clip(clip(u, now - loop.error_max_m_s, now + loop.error_max_m_s), -most, most)


class VelocityTracking:
    """Corrections of set-points. Call ``observe`` once a tick and ``command`` for each set-point."""

    memory: TrackingMemory
    late: LateMemory
    by_feedback: bool  # whether x and y use velocity feedback instead of the lag compensation; never for z
    loop: VelocityLoop
    vertical: VelocityLoop  # values of the vertical loop, under the names of the horizontal ones
    near: VelocityFeedback  # gains of the feedback near the pad
    far: VelocityFeedback  # gains at a distance of more than ``velocity_feedback.far_m``
    period_s: float
    delay_s: float  # age of the velocity that the feedback extrapolates, s
    late_ticks: int  # dead time of the horizontal loop, ticks

    def __init__(
        self, loop: VelocityLoop, period_s: float, feedback: VelocityFeedback | None = None,
        delay_s: float = 0.0,
    ) -> None:  # fmt: skip
        self.memory, self.loop, self.period_s, self.delay_s = TrackingMemory(), loop, period_s, delay_s
        self.vertical = replace(
            loop, lag_xy_s=loop.lag_z_s, rate_xy_1_s=loop.rate_z_1_s, gain_xy=loop.gain_z,
            error_max_m_s=math.inf,
        )  # fmt: skip
        self.near = feedback or VelocityFeedback()
        self.far, self.by_feedback = self.near.far, self.near.horizontal
        self.late_ticks = loop.late_ticks(period_s)
        self.late = LateMemory(((0.0, 0.0),) * self.late_ticks)
        self._carried: tuple[object, tuple[tuple[float, float], Vec3]] = (None, ((0.0, 0.0), ZERO))

    def observe(self, velocity_enu_m_s: Vec3, commanding: bool) -> None:
        """Compare the velocity with the model's prediction for the last set-point."""
        memory = self.memory
        if not commanding:
            memory.model_m_s, memory.model_m_s2, memory.slope_m_s2 = velocity_enu_m_s, ZERO, ZERO
            if self.late_ticks:
                self._forget(velocity_enu_m_s)
            return
        v, u, m = velocity_enu_m_s, memory.setpoint_m_s, memory.model_m_s
        dm, d, loop, t = memory.model_m_s2, memory.disturbance_m_s, self.loop, self.period_s
        if self.late_ticks:
            u = self._arrived(u)
        if self.by_feedback:
            near, delay_s = self.near, self.delay_s
            mx, dmx, dx = feedback_observed(loop, near, delay_s, t, v[0], u[0], m[0], dm[0], d[0])
            my, dmy, dy = feedback_observed(loop, near, delay_s, t, v[1], u[1], m[1], dm[1], d[1])
        else:
            mx, dmx, dx = lead_observed(loop, t, v[0], u[0], m[0], dm[0], d[0])
            my, dmy, dy = lead_observed(loop, t, v[1], u[1], m[1], dm[1], d[1])
        mz, dmz, dz = lead_observed(self.vertical, t, v[2], u[2], m[2], dm[2], d[2])
        memory.model_m_s, memory.model_m_s2 = (mx, my, mz), (dmx, dmy, dmz)
        memory.disturbance_m_s = (dx, dy, dz)

    @rare
    def _forget(self, velocity_enu_m_s: Vec3) -> None:
        """Set all queued set-points to the measured velocity, because the vehicle followed no set-points."""
        self.late.sent_m_s = (velocity_enu_m_s[:2],) * self.late_ticks

    @rare
    def _arrived(self, setpoint_m_s: Vec3) -> Vec3:
        """Queue the last set-point; return the one that takes effect now."""
        ((ux, uy), *under_way), (sx, sy, sz) = self.late.sent_m_s, setpoint_m_s
        self.late.sent_m_s = (*under_way, (sx, sy))
        return (ux, uy, sz)

    @rare
    def carried(self, velocity_m_s: Vec3) -> tuple[tuple[float, float], Vec3]:
        """Predict the horizontal motion until a new set-point takes effect, m, and the velocity then, m/s."""
        memory, sent, loop, t = self.memory, self.late.sent_m_s, self.loop, self.period_s
        if not sent or self.by_feedback:
            return (0.0, 0.0), velocity_m_s
        given = (velocity_m_s, memory.model_m_s, memory.model_m_s2, sent)
        if given == self._carried[0]:  # this is a second call in one tick
            return self._carried[1]
        (vx, vy, vz), (mx, my, _), (dmx, dmy, _) = given[:3]
        x_m, vx = lead_carried(loop, t, vx, mx, dmx, [x for x, _ in sent])
        y_m, vy = lead_carried(loop, t, vy, my, dmy, [y for _, y in sent])
        self._carried = (given, ((x_m, y_m), (vx, vy, vz)))
        return self._carried[1]

    def command(
        self, before_m_s: Vec3, reference_m_s: Vec3, velocity_m_s: Vec3, most_m_s: Vec3,
        least_z_m_s: float = -math.inf, far: bool = False,
    ) -> Vec3:  # fmt: skip
        """Return the set-point with which the vehicle follows the reference velocity."""
        memory, b, r, v, loop, t = (
            self.memory, before_m_s, reference_m_s, velocity_m_s, self.loop, self.period_s
        )  # fmt: skip
        if self.late_ticks:
            v = self.carried(v)[1]
        m, dm, d, s = memory.model_m_s, memory.model_m_s2, memory.disturbance_m_s, memory.slope_m_s2
        if self.by_feedback:
            fed, age_s = self.far if far else self.near, self.delay_s
            sx, ux = feedback_commanded(loop, fed, age_s, t, b[0], r[0], s[0], m[0], dm[0], d[0], most_m_s[0])
            sy, uy = feedback_commanded(loop, fed, age_s, t, b[1], r[1], s[1], m[1], dm[1], d[1], most_m_s[1])
        else:
            sx, ux = lead_commanded(loop, t, b[0], r[0], v[0], s[0], d[0], most_m_s[0])
            sy, uy = lead_commanded(loop, t, b[1], r[1], v[1], s[1], d[1], most_m_s[1])
        sz, uz = lead_commanded(self.vertical, t, b[2], r[2], v[2], s[2], d[2], most_m_s[2])
        uz = min(max(uz, least_z_m_s - d[2]), most_m_s[2])
        memory.slope_m_s2, memory.setpoint_m_s = (sx, sy, sz), (ux, uy, uz)
        return memory.setpoint_m_s
