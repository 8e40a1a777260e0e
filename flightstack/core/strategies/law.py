"""What differs between the filters: how the world is seen, which barrier is held, what goes on the wire.

``PAPER`` takes the newest sample as it came, holds the barrier itself and sends the filtered velocity, as
printed. ``ROBUST`` estimates, holds the barrier with a margin, minds the velocity that is really flown, and
corrects the set-point for the vehicle's lag (docs/how_it_works/robust_filter.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Protocol

from flightstack.core.memory import MotionMemory, TrackingMemory
from flightstack.core.mission.conditions import View
from flightstack.core.parameters.flight import FilterKind, FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.robust_barrier import RobustBarrier
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.core.target.estimator import TargetEstimator
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import OwnState, TargetSample, Vec3

Held = Barrier | RobustBarrier


class Law(Protocol):
    """One filter's view of the world and way to the wire.

    Attributes:
        rate_1_s: at which h may be used up.
        acceleration_max_m_s2: of the velocity wanted.
        motion: state of the estimator.
        tracking: state of the corrections.
        contact_speed_max_m_s: relative to the pad, that a set-point of the touchdown may lead to.
    """

    rate_1_s: float
    acceleration_max_m_s2: Vec3
    motion: MotionMemory
    tracking: TrackingMemory
    contact_speed_max_m_s: float

    def take(self, sample: TargetSample) -> None:
        """Take a believed sample."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState | None:
        """Where the target is now."""

    def own(self, own: OwnState) -> OwnState:
        """Where the vehicle is now."""

    def observe(self, velocity_enu_m_s: Vec3, *, commanding: bool) -> None:
        """Look at the velocity really flown."""

    def held(self, seen: View) -> Held:
        """Barrier the filter holds."""

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, seen: View) -> float:
        """Least vertical velocity, with the horizontal velocity there is; -inf for no such bound."""

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, seen: View, least_z_m_s: float = -math.inf
    ) -> Vec3:
        """Set-point that makes the vehicle fly the velocity wanted.

        Args:
            before_m_s: velocity wanted that the present one was reached from within a tick.
            wanted_m_s: velocity wanted now.
            seen: what is known.
            least_z_m_s: lowest vertical velocity that the set-point may lead to if none follows it.
        """


class PaperLaw:
    """Eq. 11 as printed."""

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        self.rate_1_s = config.barrier.omega_1_s
        self.acceleration_max_m_s2 = config.limits.slew_max_m_s2
        self.motion, self.tracking = MotionMemory(), TrackingMemory()
        self.contact_speed_max_m_s = config.touchdown.descent_m_s  # it corrects for nothing
        self._barrier = barrier

    def take(self, sample: TargetSample) -> None:
        """Nothing to learn: the track keeps the newest sample."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState | None:
        """Newest sample, carried on with its velocity."""
        return track.at(now_s)

    def own(self, own: OwnState) -> OwnState:
        """As it came."""
        return own

    def observe(self, velocity_enu_m_s: Vec3, *, commanding: bool) -> None:
        """The velocity loop is taken to be perfect."""

    def held(self, seen: View) -> Held:
        """The barrier itself."""
        del seen
        return self._barrier

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, seen: View) -> float:
        """No bound besides the program's."""
        del h_m, gradient, before_m_s, seen
        return -float("inf")

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, seen: View, least_z_m_s: float = -math.inf
    ) -> Vec3:
        """The velocity wanted."""
        del before_m_s, seen, least_z_m_s
        return wanted_m_s


class RobustLaw:
    """Eq. 11 with what the paper leaves out."""

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        self.rate_1_s = config.robust.rate_1_s
        self.acceleration_max_m_s2 = config.robust.acceleration_max_m_s2
        self.contact_speed_max_m_s = config.robust.descent_m_s + config.robust.descent_lead_max_m_s
        self._config, self._barrier = config, barrier
        self._most = config.limits.velocity_max_m_s
        self._estimator = TargetEstimator(config.target)
        self._tracking = VelocityTracking(
            config.velocity_loop, 1.0 / config.loop.rate_hz, config.velocity_feedback, config.own.delay_s
        )
        self._slope = barrier.slope(config.touchdown.pad_radius_m)  # steepest outside the pad
        self._lag_z_s = config.velocity_loop.lag_z_s
        # so that the margin is there in full where judging begins, at the pad's edge
        edge = config.touchdown.pad_radius_m / config.robust.fade_radius_m
        self._full = -math.expm1(-edge * edge)

    @property
    def motion(self) -> MotionMemory:
        """State of the estimator."""
        return self._estimator.memory

    @motion.setter
    def motion(self, memory: MotionMemory) -> None:
        self._estimator.memory = memory

    @property
    def tracking(self) -> TrackingMemory:
        """State of the corrections."""
        return self._tracking.memory

    @tracking.setter
    def tracking(self, memory: TrackingMemory) -> None:
        self._tracking.memory = memory

    def take(self, sample: TargetSample) -> None:
        """Update the estimate."""
        self._estimator.update(
            sample.source_time_s,
            sample.position_enu_m,
            sample.velocity_enu_m_s,
            sample.yaw_rad,
            sample.position_sigma_m,
            sample.velocity_sigma_m_s,
        )

    def target(self, track: TargetTrack, now_s: float) -> TargetState | None:
        """Estimate carried on to now; the shortest delay, which no clock shows, is a parameter.

        No further than the age limit: beyond it the target is lost, and only what stays bounded is of use.
        """
        last = track.memory.last
        if last is None:
            return None
        delay_s = self._config.target.delay_s
        latest_s = self._estimator.memory.time_s + self._config.checks.target_age_max_s
        motion = self._estimator.at(min(now_s - track.memory.offset_s, latest_s) + delay_s)
        return TargetState(
            track.age_s(last, now_s) + delay_s,
            motion.position_enu_m,
            motion.velocity_enu_m_s,
            last.yaw_rad,
            motion.position_sigma_m,
            motion.position_sigma_z_m,
        )

    def own(self, own: OwnState) -> OwnState:
        """Carried on by its delay."""
        t, (x, y, z), (vx, vy, vz) = self._config.own.delay_s, own.position_enu_m, own.velocity_enu_m_s
        position = (x + t * vx, y + t * vy, z + t * vz)
        return OwnState(own.arrival_s, own.source_time_s, position, own.velocity_enu_m_s, own.yaw_rad)

    def observe(self, velocity_enu_m_s: Vec3, *, commanding: bool) -> None:
        """Learn the disturbance."""
        self._tracking.observe(velocity_enu_m_s, commanding=commanding)

    def held(self, seen: View) -> Held:
        """The barrier with a margin for what is uncertain now."""
        robust, target, own_m = self._config.robust, seen.target, self._config.own.position_noise_m
        sigma_xy_m = math.hypot(target.position_sigma_m, own_m) if target is not None else own_m
        sigma_z_m = math.hypot(target.position_sigma_z_m, own_m) if target is not None else own_m
        margin_m = robust.margin_m(self._slope, sigma_xy_m, sigma_z_m)
        return RobustBarrier(self._barrier, margin_m / self._full, robust.fade_radius_m)

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, seen: View) -> float:
        """Vertical velocity that holds the barrier whatever the horizontal loop is still doing.

        Horizontal velocity follows late, vertical velocity sooner: so the horizontal velocity is taken as
        measured. Of h counts what is left when the vertical loop has caught up with the velocity wanted.
        """
        own, target = seen.inputs.own, seen.target
        assert own is not None
        assert target is not None
        v, t = own.velocity_enu_m_s, target.velocity_enu_m_s
        left_m = h_m + self._lag_z_s * min(0.0, v[2] - before_m_s[2])
        inward = gradient[0] * (v[0] - t[0]) + gradient[1] * (v[1] - t[1])
        return t[2] - self.rate_1_s * left_m - inward

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, seen: View, least_z_m_s: float = -math.inf
    ) -> Vec3:
        """Corrected for lag and disturbance."""
        own = seen.inputs.own
        velocity = own.velocity_enu_m_s if own is not None else wanted_m_s
        return self._tracking.command(before_m_s, wanted_m_s, velocity, self._most, least_z_m_s)


LAWS: Mapping[FilterKind, Callable[[FlightConfig, Barrier], Law]] = MappingProxyType(
    {FilterKind.PAPER: PaperLaw, FilterKind.ROBUST: RobustLaw}
)
