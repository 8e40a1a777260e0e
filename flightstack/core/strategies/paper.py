"""The paper's filter, eq. 11 as printed.

It takes the newest sample of the target as it came, holds the barrier itself and sends the filtered velocity.
"""

from __future__ import annotations

import math

from flightstack.core.memory import MotionMemory, TrackingMemory
from flightstack.core.parameters.ends import TouchdownRule
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import ActiveBarrier, Barrier
from flightstack.core.safety.position_loop import nominal_velocity
from flightstack.core.safety.qp_filter import Program, SafetyFilter
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.strategies.strategy import Strategy
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import ZERO, OwnState, TargetSample, Vec3


class PaperFilter(Strategy):
    """Eq. 11 as printed: the velocity loop is taken to be perfect, and nothing is estimated."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # as printed: it knows nothing of the velocity loop
    waits_filtered = False

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        self.rate_1_s = config.barrier.omega_1_s
        self.acceleration_max_m_s2 = config.limits.slew_max_m_s2
        self.contact_speed_max_m_s = config.touchdown.descent_m_s  # it corrects for nothing
        self.stopped_below_m = 0.0
        self.motion, self.tracking = MotionMemory(), TrackingMemory()
        self._config, self._barrier = config, barrier

    @staticmethod
    def check_config(config: FlightConfig) -> None:
        """Nothing besides what holds for every filter."""

    def take(self, sample: TargetSample) -> None:
        """Do nothing: the track keeps the newest sample."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState | None:
        """Newest sample, moved on with its velocity."""
        return track.at(now_s)

    def vehicle(self, own: OwnState) -> OwnState:
        """As it came."""
        return own

    def observe(self, velocity_enu_m_s: Vec3, *, commanding: bool) -> None:
        """Learn nothing."""

    def barrier(self, snapshot: Snapshot) -> ActiveBarrier:
        """The paper's barrier."""
        del snapshot
        return self._barrier

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, at: Relative) -> float:
        """No bound besides the program's."""
        del h_m, gradient, before_m_s, at
        return -math.inf

    def program(self) -> Program:
        """The quadratic program."""
        return SafetyFilter(self.rate_1_s)

    def approach_m_s(self, at: Relative, *, over_pad: bool) -> Vec3:
        """Position loop with the target's velocity fed forward (paper IV-A)."""
        del over_pad
        return nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, at.target.velocity_enu_m_s)

    def descent_m_s(self, at: Relative) -> Vec3 | None:
        """Straight down over the pad's middle; by the paper's rule the motors go off at once."""
        touchdown, t = self._config.touchdown, at.target.velocity_enu_m_s
        if touchdown.rule is TouchdownRule.PAPER:
            return None
        x, y, _ = nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, t)
        return (x, y, t[2] - touchdown.descent_m_s)

    def hold_m_s(self, target: TargetState) -> Vec3:
        """Stand still."""
        del target
        return ZERO

    def may_touch(self, at: Relative) -> bool:
        """Below the touchdown height in the descending cone (paper V)."""
        touchdown = self._config.touchdown
        low = at.e_m[2] < touchdown.height_m and at.d_m <= touchdown.pad_radius_m
        return low and self._barrier.h(at.e_m) >= 0.0

    def stopped(self, at: Relative, command_m_s: Vec3) -> bool:
        """Not told by this filter: contact is standing on the pad."""
        del at, command_m_s
        return False

    def drifts(self, at: Relative) -> bool:
        """Not watched: it never goes around."""
        del at
        return False

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, snapshot: Snapshot, least_z_m_s: float = -math.inf
    ) -> Vec3:
        """The velocity wanted."""
        del before_m_s, snapshot, least_z_m_s
        return wanted_m_s
