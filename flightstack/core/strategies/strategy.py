"""The interface of a safety filter: everything in which one filter differs from another.

A filter must define its barrier, the nominal velocity of the approach, the condition of the touchdown and its
velocity. With the class attribute ``certificate`` it can be proven. It may also estimate
target and vehicle, detect contact and drift, and correct the set-point; the defaults do none of that. To add
one, write a class with this interface: ``MODULE:NAME`` selects it (``examples/own_filter.py``).
``parameters/filters.py`` has a line for each filter of the package.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
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
    filter may store from tick to tick: they are written into the log, and a replay restores them.

    Args:
        config: configuration of the flight.
        barrier: the paper's barrier with the configured shape.

    Attributes:
        certificate: ``MODULE:NAME`` of the function that returns the checks of a configuration
            (``FlightConfig -> list[Check]``, flightstack/verify). It is about what this class flies: a
            subclass does not inherit it, and has none until it names its own.
        watches_swinging: a vehicle that swings over the pad aborts (``checks.swings_max``).
        ignores: keys of the configuration that it does not read, and the key that it reads in their place.
        waits_filtered: a vehicle found in the air keeps clear of the barrier while it waits.
        rate_1_s: relative rate at which h may fall.
        acceleration_max_m_s2: largest change of the commanded velocity, on each axis.
        contact_speed_max_m_s: largest speed relative to the pad that a set-point of the touchdown may cause.
        stopped_below_m: height above the pad below which a stopped descent is contact; 0: nowhere.
        motion: state of the estimator of the target.
        tracking: state of the corrections of the set-point.
        own: state of the estimator of the vehicle state.
        late: set-points that have no effect yet (dead time).
    """

    certificate: ClassVar[str] = ""
    watches_swinging: ClassVar[bool] = True
    ignores: ClassVar[Mapping[str, str]] = MappingProxyType({})
    waits_filtered: ClassVar[bool] = True
    rate_1_s: float
    acceleration_max_m_s2: Vec3
    contact_speed_max_m_s: float
    stopped_below_m: float
    motion: MotionMemory
    tracking: TrackingMemory
    own: OwnMemory
    late: LateMemory
    _by_rule: bool  # paper's touchdown rule is configured

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
        """Refuse combinations of values that cannot work; the certificate proves the rest.

        Raises:
            ConfigError: which value, what is allowed.
        """

    @abstractmethod
    def barrier(self, at: Relative) -> ActiveBarrier:
        """Barrier that is enforced in this tick."""

    @abstractmethod
    def approach_m_s(self, at: Relative, over_pad: bool) -> Vec3:
        """Nominal velocity on the way to the pad.

        Args:
            at: vehicle relative to target.
            over_pad: the vehicle is inside the descending cone, phase LAND.
        """

    @abstractmethod
    def descent_m_s(self, at: Relative) -> Vec3:
        """Velocity of the touchdown; it is not filtered."""

    @abstractmethod
    def may_touch(self, at: Relative) -> bool:
        """Whether the touchdown may begin at this position and velocity."""

    def motors_off(self, at: Relative) -> bool:
        """Whether the motors stop before contact in the touchdown; with the paper's rule at once."""
        return self._by_rule

    def program(self) -> Program:
        """Make the program that filters the nominal velocity; it is allocated once."""
        return SafetyFilter(self.rate_1_s)

    def take(self, sample: TargetSample) -> None:
        """Update the estimate of the target with an accepted sample."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState:
        """Estimate the present state of the target; at least one sample was received."""
        return track.at(now_s)

    def vehicle(self, own: OwnState) -> OwnState:
        """Estimate the present vehicle state from the newest one received."""
        return own

    def observe(self, velocity_enu_m_s: Vec3, commanding: bool) -> None:
        """Update the estimates of the vehicle with its measured velocity.

        Args:
            velocity_enu_m_s: measured now.
            commanding: the vehicle followed the last set-point.
        """

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, at: Relative) -> float:
        """Lower bound of the vertical velocity, in addition to the program; -inf for none.

        Args:
            h_m: value of the active barrier.
            gradient: its gradient by position.
            before_m_s: commanded velocity of the last tick.
            at: vehicle relative to target.
        """
        return -math.inf

    def hold_m_s(self, target: TargetState) -> Vec3:
        """Velocity while an input is lost after the start of the landing; ``target`` may be the lost one."""
        return ZERO

    def stopped(self, at: Relative, command_m_s: Vec3) -> bool:
        """Whether the vehicle is commanded to descend and does not; for some time, this counts as contact.

        Args:
            at: vehicle relative to target.
            command_m_s: commanded velocity of the last tick.
        """
        return False

    def drifts(self, at: Relative) -> bool:
        """Whether the touchdown will miss the pad while there is still room to climb away."""
        return False

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, velocity_m_s: Vec3, d_m: float, least_z_m_s: float
    ) -> Vec3:
        """Set-point that makes the vehicle fly the commanded velocity.

        Args:
            before_m_s: last command, or the measured velocity if there was none.
            wanted_m_s: commanded velocity of this tick.
            velocity_m_s: velocity of the vehicle.
            d_m: horizontal distance from the landing spot; NaN: unknown.
            least_z_m_s: lowest vertical velocity to which the set-point may lead if it is the last one.
        """
        return wanted_m_s


def strategy_class(name: str) -> type[Strategy]:
    """Class of a filter by its name. Raises ConfigError: there is no such filter, or it is none."""
    found = named(name)
    if not (isinstance(found, type) and issubclass(found, Strategy)):
        raise ConfigError(
            f"filter: found {name!r}, which is no subclass of flightstack.core.strategies.strategy.Strategy"
        )
    missing = sorted(found.__abstractmethods__)
    if missing:
        raise ConfigError(f"filter: found {name!r}, which lacks {', '.join(missing)}")
    return found


def ignored(config: FlightConfig) -> list[str]:
    """Keys that were changed, though the filter does not read them: a sentence each."""
    found = []
    for key, read in strategy_class(config.filter).ignores.items():
        table, _, name = key.partition(".")
        section = getattr(config, table)
        (default,) = (each.default for each in fields(section) if each.name == name)
        if getattr(section, name) != default:
            found.append(f"{config.filter} ignores {key}; it reads {read}")
    return found


def strategy_of(config: FlightConfig) -> Strategy:
    """Make the filter of a configuration.

    Raises ConfigError: there is no such filter, or it refuses the configuration.
    """
    found = strategy_class(config.filter)
    found.check_config(config)
    return found(config, config.barrier.build())


def packaged_strategy_of(config: FlightConfig) -> Strategy | None:
    """Filter for a reader of logs; ``None`` for a filter from outside: no log decides which code runs."""
    return strategy_of(config) if config.filter in FILTERS else None
