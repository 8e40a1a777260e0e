"""Interface of a safety filter: the methods in which filters can differ.

The base class is complete: the paper's barrier and program, the position loop as approach, a straight
descent. A filter overrides the methods in which it differs; one method, ``filter``, is enough. The class
attribute ``certificate`` names the proof. ``MODULE:NAME`` selects a class (``examples/own_filter.py``); the
filters of the package are in ``packaged/``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import one_line
from flightstack.core.memory import FilterMemory, LateMemory, MotionMemory, OwnMemory, TrackingMemory
from flightstack.core.numeric import UNSEEN
from flightstack.core.parameters.filters import FILTERS, file_of, named
from flightstack.core.parameters.flight import FlightConfig, TouchdownRule
from flightstack.core.safety.barrier import ActiveBarrier, Barrier, problem_of
from flightstack.core.safety.position_loop import nominal_velocity
from flightstack.core.safety.qp_filter import FilterResult
from flightstack.core.snapshot import Relative
from flightstack.core.strategies.user_filter import (
    NEEDED,
    Ask,
    At,
    Exchange,
    Vector,
    checked_velocity,
    compiled_as,
    three_finite,
)
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import ZERO, FilterStatus, OwnState, TargetSample, Vec3


class Filter:
    """Base class of a safety filter, which changes the nominal velocity if this velocity is not safe.

    Write one method in a subclass: ``filter``, which returns the velocity. All other methods and attributes
    have defaults. Velocities are ENU, m/s; positions ENU, m.

    A filter must store data for later ticks only in ``state`` or, as the package's filters do, in ``motion``,
    ``tracking``, ``own`` and ``late``. A log contains these five attributes, and a replay compares them.

    Args:
        config: configuration of the flight.
        barrier: the paper's barrier with the configured shape.

    Attributes:
        State: class of ``state``, a dataclass whose fields have defaults and are numbers, texts, tuples or
        dataclasses; None: ``state`` is None.
        certificate: ``MODULE:NAME`` of the function that returns the checks of a configuration
        (``FlightConfig -> list[Check]``, flightstack/verify). The certificate covers this class only: a
        subclass has no certificate until it names one.
        watches_swinging: whether a vehicle that oscillates over the pad must abort (``checks.swings_max``).
        ignores: keys of the configuration that the filter does not read, with the key that it reads instead.
        waits_filtered: whether the barrier also applies in WAIT to a vehicle that starts in the air.
        rate_1_s: maximum allowed decay rate of h, 1/s.
        acceleration_max_m_s2: maximum rate of change of the commanded velocity on each axis, m/s^2.
        contact_speed_max_m_s: maximum speed relative to the pad that a touchdown set-point may cause, m/s.
        stopped_below_m: height above the pad below which a stopped descent counts as contact; 0: never.
        motion: state of the target estimator.
        tracking: state of the set-point corrections.
        own: state of the estimator that computes the vehicle state.
        late: set-points that have no effect yet (dead time).
    """

    State: ClassVar[type[Any] | None] = None
    certificate: ClassVar[str] = ""
    watches_swinging: ClassVar[bool] = True
    ignores: ClassVar[Mapping[str, str]] = MappingProxyType({})
    waits_filtered: ClassVar[bool] = True
    rate_1_s: float
    acceleration_max_m_s2: Vec3
    contact_speed_max_m_s: float
    stopped_below_m: float
    motion: Annotated[MotionMemory, UNSEEN]  # unused, because this class has no estimator
    tracking: TrackingMemory
    own: OwnMemory
    late: LateMemory
    exchange: Exchange
    replaces_program: bool  # whether the class has its own method ``filter``
    _by_rule: bool  # whether the paper's touchdown rule is configured
    _config: FlightConfig
    _barrier: Barrier

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        self._config, self._barrier = config, barrier
        self.replaces_program = type(self).filter is not Filter.filter
        self.memory = FilterMemory()
        self.state: Any = self.State() if self.State is not None else None
        self.rate_1_s = config.barrier.omega_1_s
        self.acceleration_max_m_s2 = config.limits.slew_max_m_s2
        self.contact_speed_max_m_s = config.touchdown.descent_m_s
        self.stopped_below_m = 0.0
        self.motion, self.tracking, self.own = MotionMemory(), TrackingMemory(), OwnMemory()
        self.late, self.exchange = LateMemory(), Exchange()
        self.compiled_as = compiled_as(type(self)) or type(self)
        self.ask: Ask | None = None  # agent that chooses the velocity (flightstack/api/env.py)
        # answers in a tick that compiled code started: velocity of the agent, result of the user's filter
        self.answer: Vec3 | None = None
        self.own_result: tuple[FilterResult, str] | None = None  # result and rejection reason
        self._by_rule = config.touchdown.rule is TouchdownRule.PAPER

    @staticmethod
    def check_config(config: FlightConfig) -> None:
        """Reject combinations of values that cannot work; the certificate checks the others in detail.

        Raises:
            ConfigError: a value is not allowed; the text names the value and what is allowed.
        """

    def filter(self, nominal: Vector, at: At) -> ArrayLike:
        """Return the velocity for APPROACH and LAND, m/s ENU, (3,).

        The method replaces the program of eq. 11. The result is limited to ``at.lower_m_s`` and
        ``at.upper_m_s``; the gate does not check it against the barrier. ``at.enforced(velocity)`` is the
        nearest velocity that keeps the barrier. Beside other vehicles, the fleet's program then also enforces
        the barrier. A result or an argument of ``at.enforced`` that is not three finite numbers, or an
        exception, aborts the flight with a text that names the class.

        Args:
            nominal: nominal velocity, m/s ENU, (3,).
            at: vehicle, target, barrier and limits in this tick.
        """
        return at.enforced(nominal)

    def filtered(
        self, at: Relative, h_m: float, gradient: Vec3, dh_dt_m_s: float, nominal: Vec3, lower: Vec3,
        upper: Vec3,
    ) -> FilterResult:  # fmt: skip
        """Filter a velocity with the user's method ``filter``, which is called once per tick.

        Return REJECTED, with a recorded reason, if the result is not a valid velocity.
        """
        given, self.own_result = self.own_result, None
        if given is not None:
            result, self.memory.refusal = given
            return result
        own, target = at.own, at.target
        position, velocity, pad, moves, e_m, steepest, lowest, highest = map(np.array, (
            own.position_enu_m, own.velocity_enu_m_s, target.position_enu_m, target.velocity_enu_m_s, at.e_m,
            gradient, lower, upper,
        ))  # fmt: skip
        seen = At(
            own.arrival_s, position, velocity, pad, moves, e_m, at.d_m, h_m, steepest, dh_dt_m_s,
            self.rate_1_s, lowest, highest,
            lambda found: self.permitted_m_s(checked_velocity(found, "at.permitted"), nominal, at),
        )  # fmt: skip
        numbers, problem = None, ""
        try:
            found = self.filter(np.array(nominal), seen)
            numbers = three_finite(found)
        except Exception as error:
            problem = f"raised {type(error).__name__}: {error}"
        if numbers is None:
            name = file_of(f"{type(self).__module__}:{type(self).__name__}")
            problem = problem or f"returned {one_line(repr(found)):.60}; {NEEDED}"
            self.memory.refusal = f"{name} {problem}"
            return FilterResult(ZERO, math.nan, False, FilterStatus.REJECTED, math.nan, 0, 0.0)
        x, y, z = np.clip(numbers, lowest, highest).tolist()
        gx, gy, gz = gradient
        slack_m_s = gx * x + gy * y + gz * z - seen.bound_m_s
        return FilterResult((x, y, z), slack_m_s, (x, y, z) != nominal, FilterStatus.OWN, 0.0, 0, 0.0)

    def barrier(self, at: Relative) -> ActiveBarrier:
        """Return the barrier that is enforced in this tick; default: the paper's."""
        return self._barrier

    def approach_m_s(self, at: Relative, over_pad: bool) -> Vec3:
        """Return the nominal velocity of the approach to the pad.

        Default: position loop with feed-forward of the target's velocity (paper IV-A).

        Args:
            at: vehicle relative to target.
            over_pad: whether the vehicle is inside the descending cone (phase LAND).
        """
        return nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, at.target.velocity_enu_m_s)

    def choose(self, at: Relative, own: Vec3) -> Vec3:
        """Return the agent's nominal velocity instead of the approach velocity, if there is an agent."""
        if self.ask is None:
            return own
        answer, self.answer = self.answer, None
        return self.ask(at, own) if answer is None else answer

    def permitted_m_s(self, nominal: Vec3, own: Vec3, at: Relative) -> Vec3:
        """Limit a chosen velocity to the assumptions of the filter's margin. Default: unchanged.

        Args:
            nominal: velocity that an agent or a user's method ``filter`` chose.
            own: velocity that ``approach_m_s`` chose.
            at: vehicle relative to target.
        """
        return nominal

    def descent_m_s(self, at: Relative) -> Vec3:
        """Return the unfiltered velocity of the touchdown. Default: straight down over the pad's centre."""
        t = at.target.velocity_enu_m_s
        x, y, _ = nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, t)
        return (x, y, t[2] - self._config.touchdown.descent_m_s)

    def may_touch(self, at: Relative) -> bool:
        """Whether the start of the touchdown is allowed at this position and velocity.

        Default: below the touchdown height in the descending cone (paper V).
        """
        touchdown = self._config.touchdown
        low = at.e_m[2] < touchdown.height_m and at.d_m <= touchdown.pad_radius_m
        return low and self._barrier.h(at.e_m) >= 0.0

    def motors_off(self, at: Relative) -> bool:
        """Whether the motors stop in the touchdown before contact, as by the paper's rule."""
        return self._by_rule

    def take(self, sample: TargetSample) -> None:
        """Update the filter's target estimate with an accepted sample."""

    def target(self, track: TargetTrack, now_s: float) -> TargetState:
        """Estimate the current state of the target; at least one sample was accepted."""
        return track.at(now_s)

    def vehicle(self, own: OwnState) -> OwnState:
        """Estimate the current vehicle state from the newest one received."""
        return own

    def observe(self, velocity_enu_m_s: Vec3, commanding: bool) -> None:
        """Update the filter's estimators with the measured velocity of the vehicle.

        Args:
            velocity_enu_m_s: currently measured velocity.
            commanding: whether the vehicle followed the last set-point.
        """

    def climb_m_s(self, h_m: float, gradient: Vec3, before_m_s: Vec3, at: Relative) -> float:
        """Return a lower bound of the vertical velocity in addition to the program; -inf for no bound.

        Args:
            h_m: value of the active barrier.
            gradient: gradient of this barrier with respect to position.
            before_m_s: commanded velocity of the last tick.
            at: vehicle relative to target.
        """
        return -math.inf

    def hold_m_s(self, target: TargetState) -> Vec3:
        """Return the velocity while an input, such as ``target``, is lost after the start of the landing."""
        return ZERO

    def stopped(self, at: Relative, command_m_s: Vec3) -> bool:
        """Whether the vehicle does not follow a descent command; a lasting stop counts as contact.

        Args:
            at: vehicle relative to target.
            command_m_s: commanded velocity of the last tick.
        """
        return False

    def drifts(self, at: Relative) -> bool:
        """Whether the descent is about to miss the pad and the vehicle can still climb away (go-around)."""
        return False

    def setpoint(
        self, before_m_s: Vec3, wanted_m_s: Vec3, velocity_m_s: Vec3, d_m: float, least_z_m_s: float
    ) -> Vec3:
        """Return the set-point with which the vehicle follows the commanded velocity.

        Args:
            before_m_s: last command, or the measured velocity if there was none.
            wanted_m_s: commanded velocity of this tick.
            velocity_m_s: velocity of the vehicle.
            d_m: horizontal distance from the landing spot; NaN: unknown.
            least_z_m_s: minimum allowed vertical velocity of the vehicle if the set-point is the last one.
        """
        return wanted_m_s


def strategy_class(name: str) -> type[Filter]:
    """Return the class of a filter by its name. Raise ConfigError if there is no such filter class."""
    found = named(name)
    if not (isinstance(found, type) and issubclass(found, Filter)):
        raise ConfigError(f"filter: found {name!r}, which is no subclass of flightstack.Filter")
    state = found.State
    if state is not None and not (isinstance(state, type) and is_dataclass(state)):
        raise ConfigError(f"filter {name}: State is {state!r}; a dataclass is needed")
    return found


def ignored(config: FlightConfig) -> list[str]:
    """Return a sentence for each configured key that the filter does not read."""
    found = []
    for key, read in strategy_class(config.filter).ignores.items():
        table, _, name = key.partition(".")
        section = getattr(config, table)
        (default,) = (each.default for each in fields(section) if each.name == name)
        if getattr(section, name) != default:
            found.append(f"{config.filter} ignores {key}; it reads {read}")
    return found


def own_boundary(name: str) -> str:
    """Return a warning if verdicts judge by a boundary other than this filter's, else an empty text."""
    if strategy_class(name).barrier.__module__.startswith("flightstack."):
        return ""
    return f"judged by the paper's barrier; {name} flies a boundary of its own, which no verdict knows"


def strategy_of(config: FlightConfig) -> Filter:
    """Return the filter of a configuration.

    Raises ConfigError: there is no such filter, or it rejects the configuration.
    """
    return checked_class(config)(config, config.barrier)


def checked_class(config: FlightConfig) -> type[Filter]:
    """Return the class of a configuration's filter. Raise ConfigError: see ``strategy_of``."""
    found, e_m = strategy_class(config.filter), (1.0, 0.0, 1.0)
    found.check_config(config)
    if own_boundary(config.filter):
        at = Relative(OwnState(0.0, 0.0, e_m, ZERO, 0.0), TargetState(0.0, ZERO, ZERO, 0.0), e_m, 1.0)
        boundary = found(config, config.barrier).barrier(at)  # a new filter object
        if problem := problem_of(boundary, e_m):
            needed = "h, evaluate and linearisation_bound_m are needed, as in examples/own_boundary.py"
            raise ConfigError(f"filter {file_of(config.filter)}: its boundary {problem}; {needed}")
    return found


def packaged_strategy_of(config: FlightConfig) -> Filter | None:
    """Return the filter for a reader of logs; None if it is external: a log must not start foreign code."""
    return strategy_of(config) if config.filter in FILTERS else None
