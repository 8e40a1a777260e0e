"""Computation of the set-point from the nominal velocity: slew limit, safety filter, lag correction, gate.

``command`` needs the states of vehicle and target, and is also compiled. ``setpoint`` adds the gate and also
runs in ticks in which a state is missing. The constraints of neighbours (``rows``) are added to the filter's
program.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.fleet.member import NO_ROWS, FleetMember, Rows
from flightstack.core.fleet.program import Cone
from flightstack.core.fleet.solution import Row
from flightstack.core.memory import Memory
from flightstack.core.mission.conditions import Situation
from flightstack.core.mission.guidance import NominalCommand
from flightstack.core.numeric import NotOrdinary, rare
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.gate import ApprovedSetpoint, BarrierCheck, Gate, GateVerdict
from flightstack.core.safety.position_loop import limit, slew
from flightstack.core.safety.qp_filter import FilterResult, SafetyFilter
from flightstack.core.snapshot import Relative, Snapshot
from flightstack.core.strategies.strategy import Filter
from flightstack.core.types import ZERO, FilterStatus, Mode, Phase, Vec3


class Barriers(NamedTuple):
    """Values of the landing barrier function in this tick, and the result of the safety filter."""

    h_m: float  # value of the barrier function (paper eq. 9), m
    gradient: Vec3  # gradient of the active barrier function, margin included
    dh_dt_m_s: float  # partial time derivative of the active barrier function, m/s
    nominal: Vec3  # nominal velocity u', m/s ENU
    result: FilterResult  # filtered velocity u* with the solver's status


class Command(NamedTuple):
    """Velocity command of a tick before the gate; the states of vehicle and target are known."""

    barriers: Barriers
    wanted: Vec3  # velocity command before the lag correction, m/s ENU
    setpoint: Vec3  # velocity set-point for the autopilot, m/s ENU
    check: BarrierCheck  # data for the gate's check of a filtered velocity


class VelocityCommand(Situation):
    """Velocity command of each tick; ``memory`` has the last one."""

    program: SafetyFilter  # quadratic program of the landing, without neighbours
    gate: Gate
    slew_step: Vec3  # maximum velocity change per tick on each axis, m/s
    up_step_m_s: float  # maximum upward velocity change per tick that the thrust reserve allows, m/s
    crowded: bool  # whether neighbours or a missing right of way limit the velocity in this tick
    _period_s: float

    def __init__(self, config: FlightConfig, strategy: Filter, memory: Memory, fleet: FleetMember) -> None:
        super().__init__(config, strategy, memory)
        self.fleet, self.program, limits = fleet, SafetyFilter(strategy.rate_1_s), config.limits
        self._period_s = period_s = 1.0 / config.loop.rate_hz
        self.gate = Gate(strategy.rate_1_s, limits.velocity_max_m_s, limits.altitude_max_m, period_s)
        x, y, z = strategy.acceleration_max_m_s2
        self.slew_step = (x * period_s, y * period_s, z * period_s)
        self.up_step_m_s, self.crowded = math.inf, False
        self.rows: Rows = NO_ROWS  # constraints that neighbours put on the velocity in this tick
        lag_s = max(config.velocity_loop.lag_z_s, period_s)
        self._cone = Cone(strategy.rate_1_s, config.barrier.slope_max, lag_s, period_s)

    def accelerate(self, most_m_s2: Vec3) -> None:
        """Set the acceleration limits of this tick."""
        (x, y, z), t = most_m_s2, self._period_s
        self.strategy.acceleration_max_m_s2 = most_m_s2
        self.slew_step, self.up_step_m_s = (x * t, y * t, self.slew_step[2]), z * t

    def base(self, velocity_enu_m_s: Vec3) -> Vec3:
        """Return the base of the slew limit: the last command or, without one, the measured velocity."""
        if self.memory.commanding or self.memory.lifting:
            return self.memory.command
        return limit(velocity_enu_m_s, self.config.limits.velocity_max_m_s)

    def box(self, base: Vec3) -> tuple[Vec3, Vec3]:
        """Return the box of admissible velocities: the limits of paper eq. 11 and the slew limit."""
        (bx, by, bz), (sx, sy, sz) = base, self.slew_step
        mx, my, mz = self.config.limits.velocity_max_m_s
        x, y, z = bx - sx, by - sy, bz - sz
        lower = (x if x > -mx else -mx, y if y > -my else -my, z if z > -mz else -mz)
        x, y, z = bx + sx, by + sy, bz + (sz if sz < self.up_step_m_s else self.up_step_m_s)
        return lower, (x if x < mx else mx, y if y < my else my, z if z < mz else mz)

    def bounds(self, at: Relative, active_m: float, gradient: Vec3, base: Vec3) -> tuple[Vec3, Vec3]:
        """Return the box; its lower side includes the minimum vertical velocity that the filter requires."""
        lower, upper = self.box(base)
        climb_m_s = self.strategy.climb_m_s(active_m, gradient, base, at)
        if climb_m_s > lower[2]:
            lower = (lower[0], lower[1], min(climb_m_s, upper[2]))
        return lower, upper

    def least_z_m_s(self, target_m_s: Vec3) -> float:
        """Return the minimum vertical velocity that a set-point is allowed to cause, m/s.

        Each set-point can be the last one: if this process ends near the pad, only the pad stops the vehicle.
        """
        if self.memory.phase is not Phase.TOUCHDOWN:
            return -math.inf
        return target_m_s[2] - self.strategy.contact_speed_max_m_s

    def unsent(self, at: Relative) -> Barriers:
        """Return the barrier values for a tick that sends no set-point."""
        _, gradient, dh_dt = self.strategy.barrier(at).evaluate(at.e_m, at.target.velocity_enu_m_s)
        idle = FilterResult(ZERO, math.nan, False, FilterStatus.NOT_RUN, math.nan, 0, 0.0)
        return Barriers(self.config.barrier.h(at.e_m), gradient, dh_dt, ZERO, idle)

    def command(self, at: Relative, nominal: Vec3, filtered: bool, fresh: bool) -> Command:
        """Filter or limit a nominal velocity, and correct it for the vehicle's lag.

        The filter runs only if the states of vehicle and target are ``fresh``.
        """
        velocity_m_s, moves_m_s = at.own.velocity_enu_m_s, at.target.velocity_enu_m_s
        base, active = self.base(velocity_m_s), self.strategy.barrier(at)
        active_m, gradient, dh_dt = active.evaluate(at.e_m, moves_m_s)
        if filtered and fresh:
            lower, upper = self.bounds(at, active_m, gradient, base)
            if self.crowded:
                result = self._filtered_beside(at, active_m, gradient, dh_dt, nominal, base, lower, upper)
            elif self.strategy.replaces_program:
                result = self.strategy.filtered(at, active_m, gradient, dh_dt, nominal, lower, upper)
            else:
                result = self.program.solve(nominal, active_m, gradient, dh_dt, lower, upper)
        else:
            result = FilterResult(nominal, math.nan, False, FilterStatus.NOT_RUN, math.nan, 0, 0.0)
        wanted = result.velocity_enu_m_s if filtered else self.slewed(base, nominal)
        setpoint = self.strategy.setpoint(base, wanted, velocity_m_s, at.d_m, self.least_z_m_s(moves_m_s))
        barriers = Barriers(self.config.barrier.h(at.e_m), gradient, dh_dt, nominal, result)
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
        """Filter a velocity with landing barrier and neighbours' constraints; ``Cone`` reduces the box."""
        if self.strategy.replaces_program:
            own = self.strategy.filtered(at, active_m, gradient, dh_dt_m_s, nominal, lower, upper)
            if own.status is FilterStatus.REJECTED:
                return own
            nominal = own.velocity_enu_m_s
        landing = Row(gradient, -self.strategy.rate_1_s * active_m - dh_dt_m_s)
        moves_m_s = at.target.velocity_enu_m_s
        outward = self._cone.outward(active_m, gradient, base, moves_m_s)
        lower, upper = self._cone.box(at.d_m, active_m, nominal, moves_m_s, lower, upper)
        return self.fleet.solve(nominal, (landing, outward), self.rows, lower, upper)

    @rare
    def _clear_of_neighbours(self, wanted: Vec3, base: Vec3) -> Vec3:
        """Filter a velocity only with the neighbours' constraints, which apply in every phase."""
        if not self.rows.rows:
            return wanted
        return self.fleet.solve(wanted, (), self.rows, *self.box(base)).velocity_enu_m_s

    def ordinary_setpoint(self, at: Relative, nominal: Vec3, filtered: bool) -> tuple[Barriers, Vec3, Vec3]:
        """Return barrier values, velocity command and set-point; the gate must approve both velocities."""
        barriers, wanted, setpoint, check = self.command(at, nominal, filtered, True)
        yaw_rad, altitude_m = self.memory.yaw_rad, at.own.position_enu_m[2]
        if yaw_rad is None or (filtered and not self.gate.keeps_promise(wanted, check)):
            raise NotOrdinary
        for velocity in (wanted, setpoint):
            if self.gate.verdict(velocity, yaw_rad, True, True, altitude_m) is not GateVerdict.APPROVED:
                raise NotOrdinary
        self.memory.command, self.memory.commanding = wanted, True
        return barriers, wanted, setpoint

    def beside(self, nominal: NominalCommand, seen: Snapshot, now_s: float) -> NominalCommand:
        """Return the command with a side-step past neighbours, and store their constraints of this tick."""
        own, self.rows = seen.inputs.own, NO_ROWS
        if nominal.velocity is not None and own is not None and seen.own_ok:
            most_m_s = self.config.limits.velocity_max_m_s
            velocity, self.rows = self.fleet.beside(
                self.memory.phase, own, self.base, nominal.velocity, most_m_s, now_s
            )
            if velocity is not nominal.velocity:
                nominal = nominal._replace(velocity=velocity)
        self.crowded = bool(self.rows.rows) or not seen.permissions.may_land
        return nominal

    def setpoint(
        self, nominal: NominalCommand, snapshot: Snapshot
    ) -> tuple[Barriers | None, Vec3 | None, GateVerdict, ApprovedSetpoint | None]:
        """Return barrier values, velocity command, the gate's verdict and the approved set-point."""
        memory, own, at = self.memory, snapshot.inputs.own, snapshot.relative
        if nominal.velocity is None:
            memory.commanding = memory.lifting = False
            barriers = self.unsent(at) if at is not None else None
            return barriers, None, GateVerdict.NOT_IN_CONTROL, None
        barriers, check = None, None
        if at is not None:
            fresh = snapshot.own_ok and snapshot.target_ok
            barriers, wanted, setpoint, check = self.command(at, nominal.velocity, nominal.filtered, fresh)
        else:
            base = self.base(own.velocity_enu_m_s) if own is not None else memory.command
            wanted, target = self.slewed(base, nominal.velocity), snapshot.target
            velocity = own.velocity_enu_m_s if own is not None else wanted
            least_z_m_s = self.least_z_m_s(target.velocity_enu_m_s) if target is not None else -math.inf
            setpoint = self.strategy.setpoint(base, wanted, velocity, math.nan, least_z_m_s)
        yaw_rad = memory.yaw_rad if memory.yaw_rad is not None else math.nan
        verdict, approved = self.gate.check(
            wanted,
            setpoint,
            yaw_rad,
            own_fresh=snapshot.own_ok,
            target_fresh=snapshot.target_ok or not nominal.filtered,
            altitude_m=own.position_enu_m[2] if own is not None else math.nan,
            barrier_check=check if nominal.filtered else None,
        )
        if approved is None:
            approved = self.gate.stop(yaw_rad, own_fresh=snapshot.own_ok)
            memory.command = self.strategy.tracking.setpoint_m_s = ZERO
        else:
            memory.command = wanted
        climbs = memory.phase in (Phase.TAKEOFF, Phase.LEAVE) and not memory.climbed
        following = snapshot.inputs.status is not None and snapshot.inputs.status.mode is Mode.EXTERNAL
        memory.commanding = approved is not None and following and not climbs
        memory.lifting = approved is not None and following and climbs
        return barriers, wanted, verdict, approved
