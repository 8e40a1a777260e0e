"""Landing kernel: the code that runs in almost every tick, as plain Python or compiled from the same source.

``Controller.step`` calls these methods in every tick. Simulated campaigns call ``land``, which combines the
methods for an ordinary tick, in compiled form (``flightstack/compiled/objects.py``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from flightstack.core.fleet.member import NO_ROWS, Rows, member_of
from flightstack.core.fleet.program import Cone
from flightstack.core.fleet.solution import Row
from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import LANDED_SETTLE_S
from flightstack.core.mission.guidance import towards_pad
from flightstack.core.mission.machine import Mission
from flightstack.core.numeric import NotOrdinary, hypot, rare
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.gate import BarrierCheck, Gate, GateVerdict
from flightstack.core.safety.position_loop import limit, slew
from flightstack.core.safety.qp_filter import FilterResult, Program
from flightstack.core.snapshot import Relative
from flightstack.core.strategies.strategy import Filter, strategy_of
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.reserve import AGE_MAX_S, ReserveEstimate
from flightstack.core.target.track import TargetTrack, Verdict
from flightstack.core.types import (
    ZERO,
    Charge,
    FilterStatus,
    OwnState,
    Phase,
    TargetSample,
    Vec3,
    VehicleStatus,
)

# Time after the start of a take-off in which only the autopilot sets the climb rate, s: arming, spool-up
# (COM_SPOOLUP_TIME, 1 s), ramp (MPC_TKO_RAMP_T, 3 s). PX4 v1.16 in SITL lifts off after 4.7 to 5.7 s.
RISE_FREE_S = 7.0

FLYING = frozenset({Phase.APPROACH, Phase.LAND, Phase.TOUCHDOWN})

Rules = NDArray[np.int64]  # (n, 2) bit masks, a row per rule: required flags, blocking flags


class Barriers(NamedTuple):
    """Values of the landing barrier function in this tick, and the result of the safety filter."""

    h_m: float  # value of the barrier function (paper eq. 9), m
    gradient: Vec3  # gradient of the active barrier function, which includes the margin
    dh_dt_m_s: float  # partial time derivative of the active barrier function, m/s
    nominal: Vec3  # nominal velocity u', m/s ENU
    result: FilterResult  # filtered velocity u* with the solver's status


class Command(NamedTuple):
    """Velocity command of a tick before the gate; the states of vehicle and target are known."""

    barriers: Barriers
    wanted: Vec3  # velocity command before the lag correction, m/s ENU
    setpoint: Vec3  # velocity set-point for the autopilot, m/s ENU
    check: BarrierCheck  # data for the gate's check of a filtered velocity


class Landing(NamedTuple):
    """Result of an ordinary tick of a landing."""

    sends: bool  # whether the tick sends a set-point
    at: Relative
    barriers: Barriers
    wanted: Vec3
    setpoint: Vec3


class LandingKernel:
    """Parts of the controller whose methods also run in compiled form."""

    config: FlightConfig
    barrier: Barrier
    memory: Memory
    track: TargetTrack
    plausibility: Plausibility
    strategy: Filter
    program: Program  # quadratic program of the landing, plain or compiled
    reserve_estimate: ReserveEstimate | None
    slew_step: Vec3
    up_step_m_s: float  # largest upward velocity change per tick that the thrust reserve allows
    crowded: bool  # whether neighbours or a missing right of way limit the velocity in this tick
    _has_reserve: bool  # whether ``reserve_estimate`` is set
    _mission: Mission
    _gate: Gate
    _period_s: float

    def __init__(self, config: FlightConfig) -> None:
        self.config = config
        self.barrier = config.barrier.build()
        self.track = TargetTrack(config.checks, 1.0 / config.loop.rate_hz)
        self.plausibility = Plausibility(config)
        self.strategy = strategy_of(config)
        self._period_s = 1.0 / config.loop.rate_hz
        most, table = self.strategy.acceleration_max_m_s2, config.reserve
        self.reserve_estimate = ReserveEstimate(table, most, self._period_s) if table is not None else None
        self._has_reserve = table is not None
        self._mission = Mission(
            config, self.barrier, self.strategy, self.track, self.plausibility, self.reserve_estimate
        )
        self.memory = self._mission.memory
        self.program = self.strategy.program()
        limits = config.limits
        self._gate = Gate(
            self.strategy.rate_1_s, limits.velocity_max_m_s, limits.altitude_max_m, self._period_s
        )
        self.slew_step = (most[0] * self._period_s, most[1] * self._period_s, most[2] * self._period_s)
        self.up_step_m_s, self.crowded = math.inf, False
        lag_s = max(config.velocity_loop.lag_z_s, self._period_s)
        self._fleet = member_of(config)
        self._rows: Rows = NO_ROWS  # constraints by the neighbours in this tick
        self._cone = Cone(self.strategy.rate_1_s, self.barrier.slope_max, lag_s, self._period_s)

    @property
    def in_free_flight(self) -> bool:
        """Whether the vehicle follows velocity commands away from the support and ground effect of a pad."""
        return self.memory.commanding and self.memory.phase is not Phase.TOUCHDOWN

    def _accelerate(self, most_m_s2: Vec3) -> None:
        """Set the acceleration limits of this tick."""
        (x, y, z), t = most_m_s2, self._period_s
        self.strategy.acceleration_max_m_s2 = most_m_s2
        self.slew_step, self.up_step_m_s = (x * t, y * t, self.slew_step[2]), z * t

    def take(self, sample: TargetSample) -> Verdict:
        """Check a target sample, and update the target estimate if the sample is accepted."""
        verdict = self.track.accept(sample)
        if verdict is Verdict.ACCEPTED:
            if self.track.stepped_s != 0.0:
                self._begin_anew()
            self.strategy.take(sample)
        return verdict

    @rare
    def _begin_anew(self) -> None:
        """Reset the target estimate, because the sender's clock has changed."""
        self.strategy.motion.time_s = math.nan

    def estimate_own(self, own: OwnState, flies: bool, now_s: float) -> OwnState:
        """Check the vehicle state, compare its velocity with the command, and predict the current state."""
        memory, plausibility, velocity = self.memory, self.plausibility, own.velocity_enu_m_s
        plausibility.take(own, memory.commanding and not memory.contact)
        trusted = plausibility.trusts(now_s)
        if trusted and memory.commanding:
            plausibility.follow(memory.command, velocity)
        elif trusted and memory.lifting and flies:
            plausibility.follow(self._lifting(velocity[2], now_s), velocity)
        else:  # the vehicle follows no set-points of this stack, or stands
            plausibility.forget()
        now = self.strategy.vehicle(own)
        self.strategy.observe(now.velocity_enu_m_s, memory.commanding and trusted)
        return now

    def _lifting(self, rises_m_s: float, now_s: float) -> Vec3:
        """Return the velocity that the vehicle should have in the climb from the ground, m/s ENU.

        The autopilot sets the climb rate (spool-up and ramp), but not the horizontal velocity; after
        ``RISE_FREE_S`` the vehicle must climb at least as fast as commanded.
        """
        x, y, up_m_s = self.memory.command
        free = now_s - self.memory.phase_since_s <= RISE_FREE_S
        return (x, y, rises_m_s if free else max(up_m_s, rises_m_s))

    def base(self, velocity_enu_m_s: Vec3) -> Vec3:
        """Return the start of the slew limit: the last command, or without one the measured velocity."""
        if self.memory.commanding or self.memory.lifting:
            return self.memory.command
        return limit(velocity_enu_m_s, self.config.limits.velocity_max_m_s)

    def box(self, base: Vec3) -> tuple[Vec3, Vec3]:
        """Return the box of admissible velocities: the limits of paper eq. 11, cut by the slew limit."""
        (bx, by, bz), (sx, sy, sz) = base, self.slew_step
        mx, my, mz = self.config.limits.velocity_max_m_s
        x, y, z = bx - sx, by - sy, bz - sz
        lower = (x if x > -mx else -mx, y if y > -my else -my, z if z > -mz else -mz)
        x, y, z = bx + sx, by + sy, bz + (sz if sz < self.up_step_m_s else self.up_step_m_s)
        return lower, (x if x < mx else mx, y if y < my else my, z if z < mz else mz)

    def bounds(self, at: Relative, active_m: float, gradient: Vec3, base: Vec3) -> tuple[Vec3, Vec3]:
        """Return the box, with the minimum vertical velocity that the filter requires besides its program."""
        lower, upper = self.box(base)
        climb_m_s = self.strategy.climb_m_s(active_m, gradient, base, at)
        if climb_m_s > lower[2]:
            lower = (lower[0], lower[1], min(climb_m_s, upper[2]))
        return lower, upper

    def least_z_m_s(self, target_m_s: Vec3) -> float:
        """Return the lowest vertical velocity that a set-point may cause if it is the last one sent, m/s.

        If the companion process ends near the pad, only the pad stops the vehicle.
        """
        if self.memory.phase is not Phase.TOUCHDOWN:
            return -math.inf
        return target_m_s[2] - self.strategy.contact_speed_max_m_s

    def unsent(self, at: Relative) -> Barriers:
        """Return the barrier values for a tick that sends no set-point."""
        _, gradient, dh_dt = self.strategy.barrier(at).evaluate(at.e_m, at.target.velocity_enu_m_s)
        idle = FilterResult(ZERO, math.nan, False, FilterStatus.NOT_RUN, math.nan, 0, 0.0)
        return Barriers(self.barrier.h(at.e_m), gradient, dh_dt, ZERO, idle)

    def command(self, at: Relative, nominal: Vec3, filtered: bool, fresh: bool) -> Command:
        """Filter or limit a nominal velocity, and correct it for the vehicle's lag.

        The filter runs only if the states of vehicle and target are ``fresh``.
        """
        velocity_m_s, moves_m_s = at.own.velocity_enu_m_s, at.target.velocity_enu_m_s
        base, active = self.base(velocity_m_s), self.strategy.barrier(at)
        active_m, gradient, dh_dt = active.evaluate(at.e_m, moves_m_s)
        result = FilterResult(nominal, math.nan, False, FilterStatus.NOT_RUN, math.nan, 0, 0.0)
        if filtered and fresh:
            lower, upper = self.bounds(at, active_m, gradient, base)
            if self.crowded:
                result = self._filtered_beside(at, active_m, gradient, dh_dt, nominal, base, lower, upper)
            elif self.strategy.replaces_program:
                result = self.strategy.filtered(at, active_m, gradient, dh_dt, nominal, lower, upper)
            else:
                result = self.program.solve(nominal, active_m, gradient, dh_dt, lower, upper)
        wanted = result.velocity_enu_m_s if filtered else self.slewed(base, nominal)
        setpoint = self.strategy.setpoint(base, wanted, velocity_m_s, at.d_m, self.least_z_m_s(moves_m_s))
        barriers = Barriers(self.barrier.h(at.e_m), gradient, dh_dt, nominal, result)
        return Command(barriers, wanted, setpoint, BarrierCheck(active, at.e_m, moves_m_s, result.status))

    def slewed(self, base: Vec3, nominal: Vec3) -> Vec3:
        """Limit a velocity by box and slew limit, without the landing barrier."""
        most = self.config.limits.velocity_max_m_s
        wanted = slew(base, limit(nominal, most), self.slew_step, self.up_step_m_s)
        return self._clear_of_neighbours(wanted, base) if self.crowded else wanted

    @rare
    def _filtered_beside(
        self, at: Relative, active_m: float, gradient: Vec3, dh_dt_m_s: float, nominal: Vec3, base: Vec3,
        lower: Vec3, upper: Vec3,
    ) -> FilterResult:  # fmt: skip
        """Filter a velocity with landing barrier and neighbours' constraints; the box shrinks at the pad."""
        if self.strategy.replaces_program:
            own = self.strategy.filtered(at, active_m, gradient, dh_dt_m_s, nominal, lower, upper)
            if own.status is FilterStatus.REJECTED:
                return own
            nominal = own.velocity_enu_m_s
        landing = Row(gradient, -self.strategy.rate_1_s * active_m - dh_dt_m_s)
        moves_m_s = at.target.velocity_enu_m_s
        outward = self._cone.outward(active_m, gradient, base, moves_m_s)
        lower, upper = self._cone.box(at.d_m, active_m, nominal, moves_m_s, lower, upper)
        return self._fleet.solve(nominal, (landing, outward), self._rows, lower, upper)

    @rare
    def _clear_of_neighbours(self, wanted: Vec3, base: Vec3) -> Vec3:
        """Filter a velocity only with the neighbours' constraints, which apply in every phase."""
        if not self._rows.rows:
            return wanted
        return self._fleet.solve(wanted, (), self._rows, *self.box(base)).velocity_enu_m_s

    def ordinary(self, status: VehicleStatus) -> bool:
        """Whether ``land`` may run the next tick: inputs are trusted, and the vehicle follows set-points."""
        memory, track = self.memory, self.track.memory
        if track.run_since_s < math.inf or track.distrusted or self.plausibility.memory.distrusted:
            return False
        if memory.lifting or memory.yaw_rad is None or not memory.good_since_s < math.inf:
            return False
        if memory.phase is Phase.LANDED:
            return not status.armed
        commanded = memory.was_armed and memory.was_external and not memory.contact
        return memory.phase in FLYING and status.flies_by_setpoints and commanded

    def land(self, own: OwnState, lasting: int, rules: Rules, now_s: float) -> Landing:
        """Run an ordinary tick of APPROACH, LAND, TOUCHDOWN or LANDED; compiled code calls this method.

        Preconditions: the target samples are processed, there is no fleet, the heartbeat is recent, and the
        vehicle follows set-points or, in LANDED, stands.
        """
        memory, strategy, plausibility, mission = self.memory, self.strategy, self.plausibility, self._mission
        target = strategy.target(self.track, now_s)
        if self.track.memory.distrusted or target.age_s > self.config.checks.target_age_max_s:
            raise NotOrdinary
        own = self.estimate_own(own, True, now_s)
        if not (plausibility.trusts(now_s) and plausibility.follows):
            raise NotOrdinary
        estimate = self.reserve_estimate
        if self._has_reserve and estimate is not None:
            flies = memory.phase is not Phase.LANDED
            if not now_s - estimate.reported.arrival_s <= AGE_MAX_S:
                raise NotOrdinary
            estimate.update(own.velocity_enu_m_s[2], self.in_free_flight, flies)
            self._accelerate(estimate.acceleration_max_m_s2)
            if flies and estimate.charge is not Charge.FIT:
                raise NotOrdinary
        (x, y, z), (px, py, pz) = own.position_enu_m, target.position_enu_m
        e_m = (x - px, y - py, z - pz)
        at = Relative(own, target, e_m, hypot(e_m[0], e_m[1]))
        memory.target_position_enu_m = target.position_enu_m
        memory.target_velocity_enu_m_s = target.velocity_enu_m_s
        memory.own_ok_s = now_s
        mission.watch_contact(at, False, now_s)
        flags = lasting | mission.flags_at(at, now_s)
        for k in range(len(rules)):
            if flags & rules[k, 0] == rules[k, 0] and not flags & rules[k, 1]:
                raise NotOrdinary
        if memory.phase is Phase.LANDED:
            if now_s - memory.phase_since_s >= LANDED_SETTLE_S:
                raise NotOrdinary
            memory.commanding = False
            return Landing(False, at, self.unsent(at), ZERO, ZERO)
        yaw_rad, filtered = memory.yaw_rad, memory.phase is not Phase.TOUCHDOWN
        if memory.contact or yaw_rad is None or (not filtered and strategy.motors_off(at)):
            raise NotOrdinary
        nominal = towards_pad(self.config, memory, strategy, at) if filtered else strategy.descent_m_s(at)
        barriers, wanted, setpoint, check = self.command(at, nominal, filtered, True)
        if filtered and not self._gate.keeps_promise(wanted, check):
            raise NotOrdinary
        for velocity in (wanted, setpoint):
            if self._gate.verdict(velocity, yaw_rad, True, True, z) is not GateVerdict.APPROVED:
                raise NotOrdinary
        memory.command, memory.commanding = wanted, True
        return Landing(True, at, barriers, wanted, setpoint)
