"""One tick of the flight stack: ``step(inputs, now) -> outputs``; no I/O, no clock, no randomness.

newest inputs -> mission machine -> position loop (u') -> CBF program (u*) -> gate -> velocity

Live flight, lockstep simulation, campaigns and log replay all call this.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from flightstack.core.fleet.cone import Cone
from flightstack.core.fleet.exact import Row
from flightstack.core.fleet.member import NO_ROWS, FleetMember, Rows
from flightstack.core.fleet.precedence import ALONE
from flightstack.core.memory import FleetState, LateState, ReserveMemory, State, WholeState
from flightstack.core.mission.guidance import NominalCommand, Situation, nominal_command
from flightstack.core.mission.machine import Mission, Transition
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import ActiveBarrier
from flightstack.core.safety.gate import ApprovedSetpoint, BarrierCheck, Gate, GateVerdict
from flightstack.core.safety.position_loop import limit, slew
from flightstack.core.safety.qp_filter import FilterResult
from flightstack.core.snapshot import Snapshot, snapshot_of
from flightstack.core.strategies.strategy import strategy_of
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.reserve import ReserveEstimate
from flightstack.core.target.track import TargetTrack, Verdict
from flightstack.core.types import (
    ZERO,
    Charge,
    FilterStatus,
    Inputs,
    Mode,
    Neighbour,
    OwnState,
    Phase,
    Request,
    Vec3,
    VehicleStatus,
)

# s of a take-off in which the autopilot alone decides how fast it rises: mode and arming, COM_SPOOLUP_TIME
# of 1 s and MPC_TKO_RAMP_T of 3 s; PX4 v1.16 in SITL lifts off after 4.7 to 5.7 s
RISE_FREE_S = 7.0


class Event(NamedTuple):
    """Something a person wants to read later. ``level`` as in rcl_interfaces/msg/Log."""

    level: int
    text: str


INFO, WARN, ERROR = 20, 30, 40


class Barriers(NamedTuple):
    """The landing barrier in this tick, and the filter's result."""

    h_m: float  # the barrier, paper eq. 9, m
    gradient: Vec3  # of the active barrier, with its margin
    dh_dt_m_s: float  # rate of the active barrier by time alone, m/s
    nominal: Vec3  # u', m/s ENU
    result: FilterResult  # u*


class Outputs(NamedTuple):
    """The decisions of a tick, and all that they were made from."""

    phase: Phase  # after this tick
    request: Request  # mode requested of the vehicle
    setpoint: ApprovedSetpoint | None  # to be sent; None: none
    gate: GateVerdict  # why the set-point may or may not be sent
    snapshot: Snapshot  # the inputs, judged
    barrier: Barriers | None  # None unless vehicle and target are known
    wanted: Vec3 | None  # velocity wanted, m/s ENU, before the correction for the vehicle's lag
    transition: Transition | None  # change of phase in this tick
    events: tuple[Event, ...]  # messages to the operator, the change of phase among them
    finished: bool  # the flight is over
    target_accepted: int  # samples of the target accepted so far
    target_rejected: int  # samples of the target refused so far
    reserve: float = math.nan  # largest thrust over weight; NaN while unknown, or without a table [reserve]
    own_word: Neighbour | None = None  # message to the fleet; None without [fleet] or without a position


def _level(transition: Transition) -> int:
    if transition.after is Phase.ABORT:
        return ERROR
    return WARN if transition.after is Phase.HOLD else INFO


def state_class(config: FlightConfig) -> type[State]:
    """Class of the state of this configuration."""
    if config.fleet is not None:
        return FleetState
    if config.velocity_loop.dead_time_s > 0.0:
        return LateState
    return WholeState if config.reserve is not None or config.own.learns else State


class Controller:
    """The pure core. ``state`` is all that a step depends on besides its inputs and the configuration."""

    def __init__(self, config: FlightConfig) -> None:
        self.config = config
        self.barrier = config.barrier.build()
        self.track = TargetTrack(config.checks, 1.0 / config.loop.rate_hz)
        self.plausibility = Plausibility(config)
        self.strategy = strategy_of(config)
        self._period_s = 1.0 / config.loop.rate_hz
        most, table = self.strategy.acceleration_max_m_s2, config.reserve
        self.reserve_estimate = ReserveEstimate(table, most, self._period_s) if table is not None else None
        self._mission = Mission(
            config, self.barrier, self.strategy, self.track, self.plausibility, self.reserve_estimate
        )
        self.memory = self._mission.memory
        self.program = self.strategy.program()  # of the landing; an equal form may take its place
        limits = config.limits
        self._gate = Gate(
            self.strategy.rate_1_s, limits.velocity_max_m_s, limits.altitude_max_m, self._period_s
        )
        step = tuple(a * self._period_s for a in most)
        self.slew_step: Vec3 = (step[0], step[1], step[2])
        self.up_step_m_s = math.inf  # besides, upwards
        fleet = config.fleet
        self._fleet = FleetMember(fleet, config.own.position_noise_m) if fleet is not None else None
        lag_s = max(config.velocity_loop.lag_z_s, self._period_s)
        self._cone = Cone(self.strategy.rate_1_s, self.barrier.slope_max, lag_s, self._period_s)

    @property
    def state(self) -> State:
        """What it remembers; still in use, so to be written down before the next step."""
        strategy = self.strategy
        known = (self.memory, self.track.memory, strategy.motion, strategy.tracking, self.plausibility.memory)
        kind = state_class(self.config)
        if kind is State:
            return State(*known)
        more = (self.reserve_estimate.memory if self.reserve_estimate else ReserveMemory(), strategy.own)
        if kind is LateState:
            return LateState(*known, *more, strategy.late)
        return FleetState(*known, *more, self._fleet.memory) if self._fleet else WholeState(*known, *more)

    def restore(self, state: State) -> None:
        """Go on from a state that was written down."""
        self.memory = self._mission.memory = state.memory
        self.track.memory = state.track
        self.strategy.motion, self.strategy.tracking = state.motion, state.tracking
        self.plausibility.memory = state.plausibility
        if isinstance(state, WholeState):
            self.strategy.own = state.own
            if self.reserve_estimate is not None:
                self.reserve_estimate.memory = state.reserve
        if isinstance(state, LateState):
            self.strategy.late = state.late
        if isinstance(state, FleetState) and self._fleet is not None:
            self._fleet.memory = state.fleet

    def step(self, inputs: Inputs, now_s: float, *, command_failed: bool = False) -> Outputs:
        """Run one tick.

        Args:
            inputs: newest of each link, and the target samples since the last tick.
            now_s: stack clock.
            command_failed: the bridge gave up on a requested mode.
        """
        memory, strategy, plausibility = self.memory, self.strategy, self.plausibility
        if inputs.own is not None and not inputs.own.is_finite:  # it would stay in every memory
            inputs = inputs._replace(own=None)
        self.track.memory.settled = memory.phase is not Phase.WAIT
        events = self._take_samples(inputs)
        target, believed_target = strategy.target(self.track, now_s), not self.track.memory.distrusted
        if target is not None and not believed_target:
            target = target._replace(velocity_enu_m_s=self.track.moves_m_s)
        if inputs.own is not None:
            plausibility.take(inputs.own, flies=memory.commanding and not memory.contact)
        believed = plausibility.believes(now_s)
        if inputs.own is not None:
            flown = memory.commanding and believed
            wanted = self._flown(inputs.own, inputs.status, now_s) if believed else None
            plausibility.follow(wanted, inputs.own.velocity_enu_m_s)
            own = strategy.vehicle(inputs.own)
            inputs = Inputs(
                own, inputs.status, inputs.target_samples, inputs.operator, inputs.power, inputs.neighbours
            )
            strategy.observe(own.velocity_enu_m_s, commanding=flown)
        follows, charge = plausibility.follows, Charge.FIT
        if self.reserve_estimate is not None:
            charge = self._weigh(self.reserve_estimate, inputs, now_s)
        way, fleet = ALONE, self._fleet
        if fleet is not None:
            events += [Event(WARN, why) for why in fleet.take(inputs.neighbours, now_s)]
            way = fleet.way(memory.phase, target, now_s, inputs.own)
        snapshot = snapshot_of(
            self.config, inputs, target, now_s, believed=believed, follows=follows, charge=charge, way=way,
            target_believed=believed_target,
        )  # fmt: skip
        transition = self._mission.step(snapshot, command_failed=command_failed, now_s=now_s)
        if transition is not None:
            events.append(Event(_level(transition), transition.text))
        asked = nominal_command(Situation(self.config, self.barrier, memory, snapshot, strategy))
        active, rows, own_word = strategy.barrier(snapshot), NO_ROWS, None
        placed = inputs.own if snapshot.own_ok else None
        if fleet is not None and asked.velocity is not None and placed is not None:
            rows = fleet.rows(memory.phase, placed, self._base(snapshot), now_s)
            most = self.config.limits.velocity_max_m_s
            if rows.near:
                asked = asked._replace(velocity=fleet.aside(limit(asked.velocity, most), rows))
        barrier = self._evaluate(asked, snapshot, active, rows)
        gate, setpoint, wanted = self._command(asked, snapshot, barrier, active, rows)
        if fleet is not None:
            events += [Event(WARN, text) for text in fleet.crowded(now_s)]
            why = self.reserve_estimate.text if self.reserve_estimate else ""
            events += [Event(WARN, text) for text in fleet.stays(way, now_s - memory.phase_since_s, why)]
            if placed is not None:
                own_word = fleet.word(memory, placed, inputs.status, self._base(snapshot), target, now_s)
        return Outputs(
            phase=memory.phase,
            request=asked.request,
            setpoint=setpoint,
            gate=gate,
            snapshot=snapshot,
            barrier=barrier,
            wanted=wanted,
            transition=transition,
            events=tuple(events),
            finished=self._finished(inputs.status, now_s),
            target_accepted=self.track.accepted,
            target_rejected=self.track.rejected,
            reserve=self.reserve_estimate.reserve if self.reserve_estimate is not None else math.nan,
            own_word=own_word,
        )

    def _finished(self, status: VehicleStatus | None, now_s: float) -> bool:
        """Whether the flight is over; a vehicle of a fleet tells its position until all others are down."""
        fleet = self._fleet
        over = self._mission.finished(status, now_s)
        return over and (fleet is None or fleet.over(now_s - self.memory.phase_since_s, now_s))

    def _weigh(self, estimate: ReserveEstimate, inputs: Inputs, now_s: float) -> Charge:
        """Estimate the thrust reserve, and limit the accelerations of this tick to those that it allows."""
        own, memory, strategy, t = inputs.own, self.memory, self.strategy, self._period_s
        rise_m_s = own.velocity_enu_m_s[2] if own is not None else 0.0
        # near the pad the ground effect helps, and on it the pad does
        flies = memory.commanding and own is not None and memory.phase is not Phase.TOUCHDOWN
        estimate.step(inputs.power, inputs.status, rise_m_s, now_s, flies=flies)
        x, y, z = strategy.acceleration_max_m_s2 = estimate.acceleration_max_m_s2
        self.slew_step, self.up_step_m_s = (x * t, y * t, self.slew_step[2]), z * t
        return estimate.charge

    def _take_samples(self, inputs: Inputs) -> list[Event]:
        events = []
        for sample in inputs.target_samples:
            verdict = self.track.accept(sample)
            if verdict is Verdict.ACCEPTED:
                if self.track.stepped_s:
                    self.strategy.motion.time_s = math.nan  # its estimate is on the clock of before
                    by = f"{self.track.stepped_s:+.2f} s"
                    events.append(Event(WARN, f"target: its sender's clock was set by {by}, or began anew"))
                self.strategy.take(sample)
            elif not (count := self.track.rejected) & (count - 1):  # it doubled: a stream would fill the log
                so_far = f" ({count} refused so far)" if count > 1 else ""
                events.append(Event(WARN, f"target sample refused: {verdict.value}{so_far}"))
        return events

    def _flown(self, own: OwnState, status: VehicleStatus | None, now_s: float) -> Vec3 | None:
        """Velocity that the vehicle is to fly since the last tick; ``None`` while it flies none of ours.

        In the climb from the ground the autopilot decides how fast it rises (it spools up and ramps), but not
        how it moves sideways; after ``RISE_FREE_S`` it has to rise as fast as wanted, faster is allowed.
        While it stands nothing is flown.
        """
        memory = self.memory
        if memory.commanding:
            return memory.command
        if not memory.lifting or status is None or not status.flies_by_setpoints:
            return None
        (x, y, up_m_s), rises_m_s = memory.command, own.velocity_enu_m_s[2]
        free = now_s - memory.phase_since_s <= RISE_FREE_S
        return (x, y, rises_m_s if free else max(up_m_s, rises_m_s))

    def _evaluate(
        self, asked: NominalCommand, snapshot: Snapshot, active: ActiveBarrier, rows: Rows
    ) -> Barriers | None:
        """Barrier and filter; the values are computed whenever they can be, the filter only for landing."""
        at = snapshot.relative
        if at is None:
            return None
        active_m, gradient, dh_dt = active.evaluate(at.e_m, at.target.velocity_enu_m_s)
        h_m = self.barrier.h(at.e_m)
        nominal = asked.velocity if asked.velocity is not None else ZERO
        if not asked.filtered or asked.velocity is None or not (snapshot.own_ok and snapshot.target_ok):
            idle = FilterResult(nominal, math.nan, False, FilterStatus.NOT_RUN, math.nan, 0, 0.0)
            return Barriers(h_m, gradient, dh_dt, nominal, idle)
        lower, upper = self._box(snapshot)
        climb_m_s = self.strategy.climb_m_s(active_m, gradient, self._base(snapshot), at)
        if climb_m_s > lower[2]:
            lower = (lower[0], lower[1], min(climb_m_s, upper[2]))
        if self._fleet is not None and (rows.rows or not snapshot.way.may_land):
            landing = Row(gradient, -self.strategy.rate_1_s * active_m - dh_dt)
            moves_m_s = at.target.velocity_enu_m_s
            outward = self._cone.outward(active_m, gradient, self._base(snapshot), moves_m_s)
            lower, upper = self._cone.box(at.d_m, active_m, nominal, moves_m_s, lower, upper)
            result = self._fleet.solve(nominal, (landing, outward), rows, lower, upper)
        else:
            result = self.program.solve(nominal, active_m, gradient, dh_dt, lower, upper)
        return Barriers(h_m, gradient, dh_dt, nominal, result)

    def _base(self, snapshot: Snapshot) -> Vec3:
        """Where the slew limit starts: the last command, or the present velocity when none was in force."""
        if self.memory.commanding or self.memory.lifting or snapshot.inputs.own is None:
            return self.memory.command
        return limit(snapshot.inputs.own.velocity_enu_m_s, self.config.limits.velocity_max_m_s)

    def _box(self, snapshot: Snapshot) -> tuple[Vec3, Vec3]:
        """Admissible velocities of this tick: the box of eq. 11 cut by what the slew limit can reach."""
        (bx, by, bz), (sx, sy, sz) = self._base(snapshot), self.slew_step
        mx, my, mz = self.config.limits.velocity_max_m_s
        x, y, z = bx - sx, by - sy, bz - sz
        lower = (x if x > -mx else -mx, y if y > -my else -my, z if z > -mz else -mz)
        x, y, z = bx + sx, by + sy, bz + (sz if sz < self.up_step_m_s else self.up_step_m_s)
        return lower, (x if x < mx else mx, y if y < my else my, z if z < mz else mz)

    def _command(
        self,
        asked: NominalCommand,
        snapshot: Snapshot,
        barrier: Barriers | None,
        active: ActiveBarrier,
        rows: Rows,
    ) -> tuple[GateVerdict, ApprovedSetpoint | None, Vec3 | None]:
        memory, own = self.memory, snapshot.inputs.own
        if asked.velocity is None:
            memory.commanding = memory.lifting = False
            return GateVerdict.NOT_IN_CONTROL, None, None
        check = None
        if (
            asked.filtered
            and barrier is not None
            and snapshot.e_m is not None
            and snapshot.target is not None
        ):
            wanted = barrier.result.velocity_enu_m_s
            check = BarrierCheck(
                active, snapshot.e_m, snapshot.target.velocity_enu_m_s, barrier.result.status
            )
        else:
            most = self.config.limits.velocity_max_m_s
            wanted = slew(self._base(snapshot), limit(asked.velocity, most), self.slew_step, self.up_step_m_s)
            if rows.rows and self._fleet is not None:  # nothing may collide in any phase
                wanted = self._fleet.solve(wanted, (), rows, *self._box(snapshot)).velocity_enu_m_s
        least_z_m_s = self._least_z_m_s(snapshot)
        setpoint = self.strategy.setpoint(self._base(snapshot), wanted, snapshot, least_z_m_s)
        yaw_rad = memory.yaw_rad if memory.yaw_rad is not None else math.nan
        verdict, approved = self._gate.check(
            wanted,
            setpoint,
            yaw_rad,
            own_fresh=snapshot.own_ok,
            target_fresh=snapshot.target_ok or not asked.filtered,
            altitude_m=own.position_enu_m[2] if own is not None else math.nan,
            barrier_check=check,
        )
        if approved is None:
            approved = self._gate.stop(yaw_rad, own_fresh=snapshot.own_ok)
            memory.command = self.strategy.tracking.setpoint_m_s = ZERO
        else:
            memory.command = wanted
        climbs = memory.phase in (Phase.TAKEOFF, Phase.LEAVE) and not memory.climbed
        following = snapshot.inputs.status is not None and snapshot.inputs.status.mode is Mode.EXTERNAL
        memory.commanding = approved is not None and following and not climbs
        memory.lifting = approved is not None and following and climbs
        return verdict, approved, wanted

    def _least_z_m_s(self, snapshot: Snapshot) -> float:
        """Lowest vertical velocity that a set-point may lead to if it stays the last one.

        So near to the pad nothing but the pad stops a vehicle whose companion has died.
        """
        if self.memory.phase is not Phase.TOUCHDOWN or snapshot.target is None:
            return -math.inf
        return snapshot.target.velocity_enu_m_s[2] - self.strategy.contact_speed_max_m_s
