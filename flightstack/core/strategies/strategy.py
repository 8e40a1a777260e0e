"""The interface of a safety filter: everything in which one filter differs from another.

A filter holds a barrier, says how to approach, when to go down and how. It may also estimate target and
vehicle, tell contact and drift, and correct the set-point; by default it does not. To add one, write a class
with this interface; ``parameters/filters.py`` has one line for each filter of the package, and
``MODULE:NAME`` names any other (``examples/own_filter.py``).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from flightstack.common.strict_toml import ConfigError
from flightstack.core.memory import LateMemory, MotionMemory, OwnMemory, TrackingMemory
from flightstack.core.parameters.ends import TouchdownRule
from flightstack.core.parameters.filters import FILTERS, named
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import ActiveBarrier, Barrier
from flightstack.core.safety.qp_filter import Program, SafetyFilter
from flightstack.core.snapshot import Relative
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import ZERO, OwnState, TargetSample, Vec3


class Strategy(ABC):
    """One safety filter.

    Velocities are ENU, m/s; positions ENU, m. ``motion``, ``tracking``, ``own`` and ``late`` are all that a
    filter may remember from tick to tick: they are written into the log and put back by a replay.

    Args:
        config: of the flight.
        barrier: the paper's, as configured.

    Attributes:
        certificate: ``MODULE:NAME`` of the function that returns the checks of a configuration
            (``FlightConfig -> list[Check]``, flightstack/verify).
        watches_swinging: a vehicle that swings over the pad aborts (``checks.swings_max``).
        waits_filtered: a vehicle found in the air keeps clear of the barrier while it waits.
        rate_1_s: at which h may be used up.
        acceleration_max_m_s2: of the velocity wanted, on each axis.
        contact_speed_max_m_s: relative to the pad, that a set-point of the touchdown may lead to.
        stopped_below_m: height above the pad below which a stopped descent is contact; 0: nowhere.
        motion: state of the estimator of the target.
        tracking: state of the corrections of the set-point.
        own: state of the estimator of the vehicle.
        late: set-points that have no effect yet.
    """

    certificate: ClassVar[str]
    watches_swinging: ClassVar[bool] = True
    waits_filtered: ClassVar[bool]
    rate_1_s: float
    acceleration_max_m_s2: Vec3
    contact_speed_max_m_s: float
    stopped_below_m: float
    motion: MotionMemory
    tracking: TrackingMemory
    own: OwnMemory
    late: LateMemory
    _by_rule: bool  # the paper's touchdown rule

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        del barrier
        self.rate_1_s = config.barrier.omega_1_s
        self.acceleration_max_m_s2 = config.limits.slew_max_m_s2
        self.contact_speed_max_m_s = config.touchdown.descent_m_s
        self.stopped_below_m = 0.0
        self.motion, self.tracking, self.own = MotionMemory(), TrackingMemory(), OwnMemory()
        self.late = LateMemory()
        self._by_rule = config.touchdown.rule is TouchdownRule.PAPER

    @staticmethod
    def check_config(config: FlightConfig) -> None:
        """Refuse combinations of values that cannot work; proofs are the certificate's part.

        Raises:
            ConfigError: which value, what is allowed.
        """

    @abstractmethod
    def barrier(self, at: Relative) -> ActiveBarrier:
        """Barrier that is held in this tick."""

    @abstractmethod
    def approach_m_s(self, at: Relative, over_pad: bool) -> Vec3:
        """Nominal velocity on the way to the pad.

        Args:
            at: vehicle relative to target.
            over_pad: the vehicle is inside the descending cone, phase LAND.
        """

    @abstractmethod
    def descent_m_s(self, at: Relative) -> Vec3:
        """Velocity of the touchdown, not filtered."""

    @abstractmethod
    def may_touch(self, at: Relative) -> bool:
        """Whether the touchdown may begin here."""

    def motors_off(self, at: Relative) -> bool:
        """Whether the motors go off in the touchdown before contact: by the paper's rule at once."""
        return self._by_rule

    def program(self) -> Program:
        """Make the program that filters the nominal velocity; it is allocated once."""
        return SafetyFilter(self.rate_1_s)

    def take(self, sample: TargetSample) -> None:
        """Update the estimate of the target with a sample that was accepted."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState:
        """Estimate the target's state for now; a sample has come before."""
        return track.at(now_s)

    def vehicle(self, own: OwnState) -> OwnState:
        """Estimate the vehicle's state for now from the newest one received."""
        return own

    def observe(self, velocity_enu_m_s: Vec3, commanding: bool) -> None:
        """Learn from the velocity measured.

        Args:
            velocity_enu_m_s: measured now.
            commanding: the last set-point was flown.
        """

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, at: Relative) -> float:
        """Least vertical velocity besides what the program asks for; -inf for no such bound.

        Args:
            h_m: value of the active barrier.
            gradient: its gradient by position.
            before_m_s: velocity wanted in the last tick.
            at: vehicle relative to target.
        """
        return -math.inf

    def hold_m_s(self, target: TargetState) -> Vec3:
        """Velocity while an input is lost, after the landing has begun; ``target`` may be the lost one."""
        return ZERO

    def stopped(self, at: Relative, command_m_s: Vec3) -> bool:
        """Whether the vehicle is commanded to sink and does not; over some time that is contact.

        Args:
            at: vehicle relative to target.
            command_m_s: velocity wanted in the last tick.
        """
        return False

    def drifts(self, at: Relative) -> bool:
        """Whether the touchdown is going to miss the pad and there is still room to climb away."""
        return False

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, velocity_m_s: Vec3, d_m: float, least_z_m_s: float
    ) -> Vec3:
        """Set-point that makes the vehicle fly the velocity wanted.

        Args:
            before_m_s: velocity wanted that the present one was reached from within a tick.
            wanted_m_s: velocity wanted now.
            velocity_m_s: of the vehicle.
            d_m: horizontal distance from the landing spot; NaN: not known.
            least_z_m_s: lowest vertical velocity that the set-point may lead to if none follows it.
        """
        return wanted_m_s


def strategy_class(name: str) -> type[Strategy]:
    """Class of a filter by its name.

    Raises:
        ConfigError: there is no such filter, or it is none.
    """
    found = named(name)
    if not (isinstance(found, type) and issubclass(found, Strategy)):
        raise ConfigError(
            f"filter: found {name!r}, which is no subclass of flightstack.core.strategies.strategy.Strategy"
        )
    missing = sorted(found.__abstractmethods__)
    missing += [each for each in ("certificate", "waits_filtered") if not hasattr(found, each)]
    if missing:
        raise ConfigError(f"filter: found {name!r}, which lacks {', '.join(missing)}")
    return found


def strategy_of(config: FlightConfig) -> Strategy:
    """Make the filter of a configuration.

    Raises:
        ConfigError: there is no such filter, or it refuses the configuration.
    """
    found = strategy_class(config.filter)
    found.check_config(config)
    return found(config, config.barrier.build())


def packaged_strategy_of(config: FlightConfig) -> Strategy | None:
    """The same for who reads a log; ``None`` for a filter from outside: no log decides which code runs."""
    return strategy_of(config) if config.filter in FILTERS else None
