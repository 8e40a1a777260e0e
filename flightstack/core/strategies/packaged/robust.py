"""Robust filter: eq. 11 with the effects that the paper neglects (docs/how_it_works/robust_filter.md).

The filter predicts target and vehicle to the current time, adds a margin for uncertainty to the barrier, uses
the measured horizontal velocity, and corrects the set-point for the vehicle's lag. The vehicle waits low
above the pad until it can descend without a stop, and goes around if it is about to miss the pad.
"""

from __future__ import annotations

import math
from types import MappingProxyType

from flightstack.common.strict_toml import ConfigError
from flightstack.core.memory import MotionMemory
from flightstack.core.numeric import hypot, rare
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier, RobustBarrier
from flightstack.core.safety.position_loop import limit, nominal_velocity
from flightstack.core.snapshot import Relative
from flightstack.core.strategies.strategy import Filter
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.target.estimator import TargetEstimator
from flightstack.core.target.own_estimator import OwnEstimator
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import OwnState, TargetSample, Vec3

COMMANDED_SHARE = 0.6  # fraction of the descent speed above which a commanded sink rate counts as a descent
STOPPED_SHARE = 0.4  # fraction of the descent speed below which a measured sink rate counts as stopped
DRIFT_SHARE = 0.6  # fraction of the corridor's radius within which no drift is detected
BRAKING = 0.5  # fraction of the acceleration limit for braking: the velocity lags, the target can speed up


class RobustFilter(Filter):
    """Filter of eq. 11 with estimates, a margin, a lag correction, and go-arounds."""

    certificate = "flightstack.verify.certificate:robust_checks"
    ignores = MappingProxyType(
        {
            "barrier.omega_1_s": "robust.rate_1_s",
            "limits.slew_max_m_s2": "robust.acceleration_max_m_s2",
            "touchdown.descent_m_s": "robust.descent_m_s",
        }
    )

    motion: MotionMemory
    brakes_m_s2: float  # assumed acceleration for braking on x and y, m/s^2
    slope: float  # steepest slope of the boundary outside the pad
    full: float  # ratio of the margin at the pad's edge to the full margin; ``margin_m`` divides by this
    estimator: TargetEstimator
    own_estimator: OwnEstimator
    _tracking: VelocityTracking
    _most: Vec3  # velocity limits, m/s
    _learns: bool  # whether errors of the reported velocity are estimated
    _has_reserve: bool  # whether the thrust reserve is estimated
    _lag_z_s: float

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        super().__init__(config, barrier)
        robust = config.robust
        self.rate_1_s = robust.rate_1_s
        self.acceleration_max_m_s2 = config.slew_max_m_s2
        self.brakes_m_s2 = BRAKING * min(config.slew_max_m_s2[:2])
        self.contact_speed_max_m_s = robust.descent_m_s + robust.descent_lead_max_m_s
        self.stopped_below_m = robust.touch_height_m
        self._most = config.limits.velocity_max_m_s
        self._learns, self._has_reserve = config.own.learns, config.reserve is not None
        loop, period_s = config.velocity_loop, 1.0 / config.loop.rate_hz
        self.estimator = TargetEstimator(config.target)
        fed_back = config.velocity_feedback.horizontal
        self.own_estimator = OwnEstimator(config.own, loop, period_s, by_loop=fed_back)
        delay_s = 0.0 if self._learns and fed_back else config.own.delay_s  # age of a velocity, s
        self._tracking = VelocityTracking(loop, period_s, config.velocity_feedback, delay_s)
        self.motion, self.tracking = self.estimator.memory, self._tracking.memory
        self.own, self.late = self.own_estimator.memory, self._tracking.late
        self.slope = barrier.slope(config.touchdown.pad_radius_m)
        self._lag_z_s = loop.lag_z_s
        edge = config.touchdown.pad_radius_m / robust.fade_radius_m
        self.full = -math.expm1(-edge * edge)

    @staticmethod
    def check_config(config: FlightConfig) -> None:
        """Reject values that contradict each other, or for which no certificate exists."""
        if found := _contradictions(config):
            raise ConfigError(found[0])

    def take(self, sample: TargetSample) -> None:
        """Update the Kalman filter of the target with a sample."""
        self.estimator.update(
            sample.source_time_s, sample.position_enu_m, sample.velocity_enu_m_s, sample.yaw_rad,
            sample.position_sigma_m, sample.velocity_sigma_m_s,
        )  # fmt: skip

    def target(self, track: TargetTrack, now_s: float) -> TargetState:
        """Return the current target estimate; the minimum delay is a parameter, because it is not measurable.

        The prediction ends at the age limit, after which the target counts as lost.
        """
        last = track.newest
        delay_s = self._config.target.delay_s
        latest_s = self.motion.time_s + self._config.checks.target_age_max_s
        motion = self.estimator.at(min(now_s - track.memory.offset_s, latest_s) + delay_s)
        return TargetState(
            track.age_s(last, now_s) + delay_s, motion.position_enu_m, motion.velocity_enu_m_s, last.yaw_rad,
            motion.position_sigma_m, motion.position_sigma_z_m,
        )  # fmt: skip

    def vehicle(self, own: OwnState) -> OwnState:
        """Return the vehicle state extrapolated by its delay, or estimated if its velocity has errors."""
        if self._learns:
            return self.own_estimator.step(own)
        t, (x, y, z), (vx, vy, vz) = self._config.own.delay_s, own.position_enu_m, own.velocity_enu_m_s
        position = (x + t * vx, y + t * vy, z + t * vz)
        return OwnState(own.arrival_s, own.source_time_s, position, own.velocity_enu_m_s, own.yaw_rad)

    def observe(self, velocity_enu_m_s: Vec3, commanding: bool) -> None:
        """Update the estimate of the disturbance."""
        self._tracking.observe(velocity_enu_m_s, commanding)
        if not self._learns:
            return
        if not commanding:
            self.own_estimator.forget()
        elif self._tracking.by_feedback:
            memory, push_1_s = self.tracking, self.own_estimator.push_1_s
            x, y = self.own.x_now, self.own.y_now
            memory.model_m_s = (x[1], y[1], memory.model_m_s[2])
            memory.model_m_s2 = (x[2], y[2], memory.model_m_s2[2])
            # velocity change that the disturbance causes in steady state, m/s
            memory.disturbance_m_s = (x[4] / push_1_s, y[4] / push_1_s, memory.disturbance_m_s[2])

    def barrier(self, at: Relative) -> RobustBarrier:
        """Return the barrier with a margin for the current uncertainty."""
        margin_m = self.margin_m(at.target.position_sigma_m, at.target.position_sigma_z_m)
        return RobustBarrier(self._barrier, margin_m, self._config.robust.fade_radius_m)

    def margin_m(self, sigma_xy_m: float, sigma_z_m: float) -> float:
        """Return the full margin (far from the pad), m, for standard deviations of the target's position."""
        robust, own_m = self._config.robust, self._config.own.position_noise_m
        margin_m = robust.margin_m(self.slope, hypot(sigma_xy_m, own_m), hypot(sigma_z_m, own_m))
        return margin_m / self.full

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, at: Relative) -> float:
        """Return the vertical velocity that satisfies eq. 11 at the measured horizontal velocity.

        The horizontal velocity responds later than the vertical one, so the measured horizontal velocity is
        used. The bound uses the h that remains when the vertical loop has reached its command.
        """
        v, t = at.own.velocity_enu_m_s, at.target.velocity_enu_m_s
        left_m = h_m + self._lag_z_s * min(0.0, v[2] - before_m_s[2])
        sinks_m_s = min(self.rate_1_s * left_m, self._braked_m_s(left_m))
        return t[2] - sinks_m_s - (gradient[0] * (v[0] - t[0]) + gradient[1] * (v[1] - t[1]))

    def _braked_m_s(self, left_m: float) -> float:
        """Return the fastest descent that the reserve can stop in ``left_m``, m/s; inf: no [reserve]."""
        if not self._has_reserve:
            return math.inf
        return math.sqrt(2.0 * BRAKING * self.acceleration_max_m_s2[2] * max(0.0, left_m))

    def approach_m_s(self, at: Relative, over_pad: bool) -> Vec3:
        """Return the velocity towards the waiting point, which is low above the pad's centre, m/s ENU."""
        robust, t, e, slip = self._config.robust, at.target.velocity_enu_m_s, at.e_m, at.slip_m_s
        if self._tracking.late_ticks:
            e, slip = self._then(at)
        gain = robust.gain_1_s
        over = robust.gain_over_pad_1_s if over_pad else gain
        above = e[2] - robust.wait_height_m - self._ahead_m(e, slip)
        x, y, z = nominal_velocity((e[0], e[1], above), (over, over, gain), t)
        if above > 0.0:
            fastest_m_s = min(robust.descent_max_m_s, self._braked_m_s(above))
            z = min(max(z, t[2] - fastest_m_s), t[2] - robust.descent_min_m_s)
        return (x, y, z)

    def permitted_m_s(self, nominal: Vec3, own: Vec3, at: Relative) -> Vec3:
        """Limit a chosen velocity, so that it has the properties of ``own`` that the certificate assumes.

        The program satisfies eq. 11 by the vertical velocity, and expects a horizontal velocity as from the
        position loop. Three limits follow. The velocity relative to the target is at most gain times
        distance. Horizontal motion reduces h no faster than the allowed rate. The vehicle sinks no faster
        than with ``own``, which accounts for the height of the boundary ahead.
        """
        if nominal == own:
            return own
        (x, y, z), (tx, ty, _), e = nominal, at.target.velocity_enu_m_s, at.e_m
        vx, vy = x - tx, y - ty
        h_m, (gx, gy, _), _ = self.barrier(at).evaluate(e, at.target.velocity_enu_m_s)
        falls_m_s, speed_m_s = -(gx * vx + gy * vy), hypot(vx, vy)
        share = min(1.0, self._config.robust.gain_1_s * at.d_m / max(speed_m_s, 1e-9))
        if vx * e[0] + vy * e[1] > 0.0 and falls_m_s > 0.0:  # outward motion inside the peak of the boundary
            share = min(share, self.rate_1_s * max(0.0, h_m) / falls_m_s)
        return (tx + share * vx, ty + share * vy, max(z, own[2]))

    @rare
    def _then(self, at: Relative) -> tuple[Vec3, tuple[float, float]]:
        """Return the relative position and horizontal velocity when a set-point of this tick takes effect."""
        late_s = self._config.velocity_loop.dead_time_s
        (ex, ey, ez), (tx, ty, _) = at.e_m, at.target.velocity_enu_m_s
        (x, y), (vx, vy, _) = self._tracking.carried(at.own.velocity_enu_m_s)
        return (ex + x - late_s * tx, ey + y - late_s * ty, ez), (vx - tx, vy - ty)

    def _ahead_m(self, e_m: Vec3, slip_m_s: tuple[float, float]) -> float:
        """Return the height of the boundary ahead, m: at its peak ring, or where the vehicle stops.

        If the vehicle overshoots the centre, h falls only when it is too late for a climb.
        """
        (ex, ey, _), (vx, vy), barrier = e_m, slip_m_s, self._barrier
        if hypot(ex, ey) > 1.0 / barrier.alpha_1_m:
            return barrier.peak_height_m
        rest_s = hypot(vx, vy) / (2.0 * self.brakes_m_s2)  # braking distance divided by current speed, s
        if rest_s * (vx * vx + vy * vy) <= -(ex * vx + ey * vy):
            return 0.0  # the vehicle stops before the centre
        return barrier.height(hypot(ex + rest_s * vx, ey + rest_s * vy))

    def descent_m_s(self, at: Relative) -> Vec3:
        """Return the velocity straight down over the pad's centre."""
        robust, t, e = self._config.robust, at.target.velocity_enu_m_s, at.e_m
        if self._tracking.late_ticks:
            e, _ = self._then(at)
        gain = robust.to_contact_1_s
        x, y, _ = nominal_velocity(e, (gain, gain, gain), t)
        return (x, y, t[2] - robust.descent_m_s)

    def motors_off(self, at: Relative) -> bool:
        """Whether the paper's touchdown rule stops the motors: below ``touchdown.height_m``."""
        return self._by_rule and at.e_m[2] < self._config.touchdown.height_m

    def hold_m_s(self, target: TargetState) -> Vec3:
        """Return a velocity that climbs and follows the last observed motion of the target.

        A vehicle that hovered at a fixed position would leave the cone of a moving target through its side.
        """
        x, y, z = target.velocity_enu_m_s
        up = min(self._most[2], max(0.0, z) + self._config.retreat.hold_climb_m_s)
        return limit((x, y, up), self._most)

    def may_touch(self, at: Relative) -> bool:
        """Whether the vehicle is low, over the centre and moving with the target, or stands on the pad."""
        robust, touchdown, z, d_m = self._config.robust, self._config.touchdown, at.e_m[2], at.d_m
        standing_m = touchdown.feet_below_reference_m + self._config.contact.gap_m
        if d_m <= touchdown.pad_radius_m and z < standing_m:
            return True
        vx, vy = at.slip_m_s
        if not (z < robust.commit_height_m and hypot(vx, vy) < robust.commit_speed_m_s):
            return False
        uncertain_m = robust.sigma_factor * at.target.position_sigma_m
        return d_m < robust.commit_radius_m and d_m + uncertain_m < robust.corridor_m

    def stopped(self, at: Relative, command_m_s: Vec3) -> bool:
        """Whether the vehicle does not follow a descent command; velocity shows this before height does."""
        pad_m_s, descent_m_s = at.target.velocity_enu_m_s[2], self._config.robust.descent_m_s
        commanded_m_s, sinking_m_s = pad_m_s - command_m_s[2], pad_m_s - at.own.velocity_enu_m_s[2]
        return commanded_m_s > COMMANDED_SHARE * descent_m_s and sinking_m_s < STOPPED_SHARE * descent_m_s

    def drifts(self, at: Relative) -> bool:
        """Whether the vehicle is about to leave the corridor above the pad with enough h for a climb."""
        corridor_m, retreat, (vx, vy) = self._config.robust.corridor_m, self._config.retreat, at.slip_m_s
        if self._barrier.h(at.e_m) < retreat.h_left_m or at.d_m < DRIFT_SHARE * corridor_m:
            return False
        outward_m_s = (at.e_m[0] * vx + at.e_m[1] * vy) / at.d_m
        return at.d_m + outward_m_s * retreat.drift_time_s > corridor_m

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, velocity_m_s: Vec3, d_m: float, least_z_m_s: float
    ) -> Vec3:
        """Return the set-point: the commanded velocity, corrected for lag, disturbance and velocity error."""
        far = d_m > self._config.velocity_feedback.far_m
        setpoint = self._tracking.command(before_m_s, wanted_m_s, velocity_m_s, self._most, least_z_m_s, far)
        return self.own_estimator.to_send(setpoint, self._most) if self._learns else setpoint


def _contradictions(config: FlightConfig) -> list[str]:
    """Return one text for each consistency rule that the values of this configuration violate."""
    checks, loop, rate_hz, robust = config.checks, config.velocity_loop, config.loop.rate_hz, config.robust
    most_1_s, late_s = loop.rate_max_1_s(1.0 / rate_hz), loop.dead_time_s
    feet_m, pad_m = config.touchdown.feet_below_reference_m, config.touchdown.pad_radius_m
    sample_s = config.target.delay_s + 1.0 / config.envelope.target_rate_hz
    beside_dead_time = {
        "velocity_feedback.horizontal": config.velocity_feedback.horizontal,
        "own.velocity_error_m_s": config.own.learns,
    }
    neighbours = [f"fleet member {number}" for number in config.fleet.others]
    names = ", ".join([*(name for name, given in beside_dead_time.items() if given), *neighbours])
    rules = [
        *((found_1_s >= most_1_s,
           f"velocity_loop.{key}: found {found_1_s:g}; with velocity_loop.damping {loop.damping:g} and "
           f"loop.rate_hz {rate_hz} the model of the loop is stable below {most_1_s:.4g} 1/s: lower it, or "
           "raise loop.rate_hz")
          for key, found_1_s in (("rate_xy_1_s", loop.rate_xy_1_s), ("rate_z_1_s", loop.rate_z_1_s))),
        (late_s > 0.0 and late_s >= loop.lag_xy_s,
         f"velocity_loop.dead_time_s: found {late_s:g}; it is a part of velocity_loop.lag_xy_s, "
         f"{loop.lag_xy_s:g} s: lower it, or raise the lag"),
        (late_s > 0.0 and names,
         f"velocity_loop.dead_time_s: found {late_s:g} together with {names}, which is proven for a loop "
         "without dead time only: set it to 0, or leave the other out"),
        *((found_s <= least_s,
           f"{key}: found {found_s:g}; by {others} {why}, {least_s:.3g} s: raise the first above that, or "
           "change the others")
          for key, found_s, least_s, others, why in (
              ("checks.target_age_max_s", checks.target_age_max_s, sample_s,
               "envelope.target_rate_hz and target.delay_s", "a sample reaches this age before the next one"),
              ("checks.own_age_max_s", checks.own_age_max_s, 1.0 / rate_hz, "loop.rate_hz",
               "a vehicle state reaches this age before the next tick"),
              ("checks.follow_lag_max_s", checks.follow_lag_max_s, loop.lag_xy_s, "velocity_loop.lag_xy_s",
               "a vehicle that follows its set-points lags this much"))),
        *((height_m <= feet_m,
           f"robust.{key}: found {height_m:g}; with touchdown.feet_below_reference_m {feet_m:g} the feet are "
           "in the pad at this height of the reference: raise it above, or lower that")
          for key, height_m in (("wait_height_m", robust.wait_height_m),
                                ("commit_height_m", robust.commit_height_m),
                                ("touch_height_m", robust.touch_height_m))),
        (robust.fade_radius_m > pad_m,
         f"robust.fade_radius_m: found {robust.fade_radius_m:g}, allowed is at most the pad's radius, "
         f"{pad_m:g} m, at whose edge the margin must be complete: lower it"),
    ]  # fmt: skip
    return [text for broken, text in rules if broken]
