"""One tick of the flight stack: ``step(inputs, now) -> outputs`` without I/O, clock or randomness.

samples -> estimates -> phase (``mission/``) -> nominal velocity -> neighbours (``beside``) -> filter and gate
(``setpoint``); the last two are methods of ``VelocityCommand`` in ``command.py``. Live flight, lockstep
simulation and replay call ``step``. ``land`` is the same sequence for an ordinary tick: a single vehicle that
follows set-points or has landed, good inputs, and no change of phase. Campaigns and, in real time, the
onboard process run ``land`` compiled. The results of ``land`` equal those of ``step`` to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import NamedTuple

from flightstack.core.command import Barriers, VelocityCommand
from flightstack.core.fleet.member import FleetMember
from flightstack.core.memory import Memory, State
from flightstack.core.mission.guidance import nominal_command, ordinary_velocity
from flightstack.core.mission.machine import Mission, Transition
from flightstack.core.mission.phases import FLYING
from flightstack.core.numeric import NotOrdinary, rare
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.gate import ApprovedSetpoint, GateVerdict
from flightstack.core.sender_clock import Reading
from flightstack.core.snapshot import Relative, Snapshot, relative, snapshot_of
from flightstack.core.strategies.strategy import Filter, strategy_of
from flightstack.core.target.plausibility import Plausibility
from flightstack.core.target.reserve import AGE_MAX_S, ReserveEstimate
from flightstack.core.target.track import TargetState, TargetTrack
from flightstack.core.types import (
    ZERO,
    Charge,
    Inputs,
    MemberStatus,
    OwnState,
    Phase,
    Request,
    TargetSample,
    Vec3,
    VehicleStatus,
)

# Time after the start of a take-off in which only the autopilot sets the climb rate, s: arming, spool-up
# (COM_SPOOLUP_TIME, 1 s), ramp (MPC_TKO_RAMP_T, 3 s). PX4 v1.16 in SITL lifts off after 4.7 to 5.7 s.
RISE_FREE_S = 7.0
INFO, WARN, ERROR = 20, 30, 40
_LEVELS = {Phase.ABORT: ERROR, Phase.HOLD: WARN}  # severity of a transition to this phase; others: INFO


class Event(NamedTuple):
    """Message to the operator; ``level``: severity as in rcl_interfaces/msg/Log."""

    level: int
    text: str


class Outputs(NamedTuple):
    """Results of one tick, with the inputs and intermediate values that led to them."""

    phase: Phase  # phase of the flight after this tick
    request: Request  # mode that the stack requests from the vehicle
    setpoint: ApprovedSetpoint | None  # set-point to send; None: no set-point
    gate: GateVerdict  # result of the gate: why the set-point is sent or rejected
    snapshot: Snapshot  # inputs of this tick, with the results of their checks
    barrier: Barriers | None  # barrier values; None unless the states of vehicle and target are known
    wanted: Vec3 | None  # velocity command before the lag correction, m/s ENU; None: no command
    transition: Transition | None  # phase transition in this tick; None: no transition
    events: tuple[Event, ...]  # messages to the operator, including that of the transition
    finished: bool  # whether the flight is over
    target_accepted: int  # number of accepted target samples
    target_rejected: int  # number of rejected target samples
    reserve: float  # ratio of maximum thrust to weight; NaN: unknown, or no table [reserve]
    member_status: MemberStatus | None  # message to the fleet; None: no table [fleet], or no position


class Landing(NamedTuple):
    """Result of an ordinary tick of a landing."""

    sends: bool  # whether the tick sends a set-point
    at: Relative
    barriers: Barriers
    wanted: Vec3  # velocity command before the lag correction, m/s ENU
    setpoint: Vec3  # velocity set-point for the autopilot, m/s ENU


class Controller:
    """Pure flight controller. A step depends only on ``state``, its inputs and the configuration."""

    config: FlightConfig
    memory: Memory
    track: TargetTrack
    plausibility: Plausibility
    strategy: Filter
    reserve: ReserveEstimate
    velocity: VelocityCommand
    _mission: Mission

    def __init__(self, config: FlightConfig) -> None:
        self.config, period_s = config, 1.0 / config.loop.rate_hz
        self.track, self.plausibility = TargetTrack(config.checks, period_s), Plausibility(config)
        self.strategy = strategy_of(config)
        self.reserve = ReserveEstimate(config.reserve, self.strategy.acceleration_max_m_s2, period_s)
        self._mission = Mission(config, self.strategy, self.track, self.plausibility, self.reserve)
        self.memory = self._mission.memory
        self._fleet = FleetMember(config.fleet, config.own.position_noise_m)
        strategy = self.strategy
        self.velocity = VelocityCommand(config, strategy, self.memory, self._fleet)
        self._state = State(
            self.memory, self.track.memory, strategy.motion, strategy.tracking, self.plausibility.memory,
            self.reserve.memory, strategy.own, strategy.late, self._fleet.memory, strategy.memory,
            strategy.state,
        )  # fmt: skip

    @property
    def state(self) -> State:
        """Controller state. The next step changes these objects, so log or copy them before it."""
        self._state.memory = self.memory  # in compiled ticks this access copies the state to Python
        return self._state

    def restore(self, state: State) -> None:
        """Replace the state by a recorded one; the next ``step`` continues from it."""
        mine = self.state
        for part in fields(State):
            into, written = getattr(mine, part.name), getattr(state, part.name)
            for each in fields(into) if into is not None else ():
                setattr(into, each.name, getattr(written, each.name))

    def step(self, inputs: Inputs, now_s: float, *, command_failed: bool = False) -> Outputs:
        """Run one tick at the time ``now_s``; ``command_failed``: the vehicle rejected the last command."""
        memory, velocity, fleet = self.memory, self.velocity, self._fleet
        events = self._take_samples(inputs.target_samples)
        target = self._estimate_target(now_s)
        inputs = self._estimate_vehicle(inputs, now_s)
        charge = self._estimate_reserve(inputs, now_s)
        texts, permissions = fleet.observe(inputs, memory.phase, target, now_s)
        events += [Event(WARN, text) for text in texts]
        seen = snapshot_of(
            self.config, inputs, target, now_s, trusted=self.plausibility.trusts(now_s),
            follows=self.plausibility.follows, charge=charge, permissions=permissions,
            target_trusted=not self.track.memory.distrusted,
        )  # fmt: skip
        transition = self._mission.step(seen, command_failed=command_failed, now_s=now_s)
        if transition is not None:
            events.append(Event(_LEVELS.get(transition.after, INFO), transition.text))
        nominal = velocity.beside(nominal_command(self._mission, seen), seen, now_s)
        barriers, wanted, gate, setpoint = velocity.setpoint(nominal, seen)
        in_phase_s = now_s - memory.phase_since_s
        for text in fleet.texts(permissions, in_phase_s, self.reserve.text, now_s):
            events.append(Event(WARN, text))
        return Outputs(
            phase=memory.phase,
            request=nominal.request,
            setpoint=setpoint,
            gate=gate,
            snapshot=seen,
            barrier=barriers,
            wanted=wanted,
            transition=transition,
            events=tuple(events),
            # a fleet member continues until ``over`` allows it to stop sending
            finished=self._mission.finished(inputs.status, now_s) and fleet.over(in_phase_s, now_s),
            target_accepted=self.track.memory.accepted,
            target_rejected=self.track.memory.rejected,
            reserve=self.reserve.reserve,
            member_status=self._message(seen, now_s),
        )

    def land(self, own: OwnState, now_s: float) -> Landing:
        """Run an ordinary tick of APPROACH, LAND, TOUCHDOWN or LANDED in the sequence of ``step``.

        Preconditions: the target samples are processed, there is no fleet, the heartbeat is recent, and the
        vehicle follows set-points or, in LANDED, stands.
        Raises NotOrdinary: ``step`` must run this tick, from the state before it.
        """
        target = self.strategy.target(self.track, now_s)
        own = self.estimate_own(own, True, now_s)
        charge = self._update_reserve(own, now_s)
        at = relative(own, target)
        plausible = self.plausibility.trusts(now_s) and self.plausibility.follows and charge is Charge.FIT
        fresh = target.age_s <= self.config.checks.target_age_max_s and not self.track.memory.distrusted
        if not (plausible and fresh):
            raise NotOrdinary
        self._mission.stay(at, now_s)
        if self.memory.phase is Phase.LANDED:
            self.memory.commanding = False
            return Landing(False, at, self.velocity.unsent(at), ZERO, ZERO)
        filtered = self.memory.phase is not Phase.TOUCHDOWN
        nominal = ordinary_velocity(self._mission, at)
        barriers, wanted, setpoint = self.velocity.ordinary_setpoint(at, nominal, filtered)
        return Landing(True, at, barriers, wanted, setpoint)

    def _take_samples(self, samples: tuple[TargetSample, ...]) -> list[Event]:
        """Process the target samples of a tick; return events about rejected samples and clock steps."""
        self.track.memory.settled = self.memory.phase is not Phase.WAIT
        events = []
        for sample in samples:
            verdict, count = self.take(sample), self.track.memory.rejected
            if verdict is Reading.FRESH:
                if self.track.stepped_s:
                    by = f"{self.track.stepped_s:+.2f} s"
                    events.append(Event(WARN, f"target: its sender's clock was set by {by}, or began anew"))
            elif not count & (count - 1):  # the count is a power of two: fewer events than samples
                so_far = f" ({count} refused so far)" if count > 1 else ""
                events.append(Event(WARN, f"target sample refused: {verdict.text}{so_far}"))
        return events

    def _estimate_target(self, now_s: float) -> TargetState | None:
        """Estimate the current target state; None before the first sample."""
        memory = self.track.memory
        if memory.last is None:
            return None
        target = self.strategy.target(self.track, now_s)
        return target._replace(velocity_enu_m_s=self.track.moves_m_s) if memory.distrusted else target

    def _estimate_vehicle(self, inputs: Inputs, now_s: float) -> Inputs:
        """Return the inputs with the current vehicle state, or None for a state that is not finite."""
        own, status, samples, operator, power, neighbours = inputs
        if own is not None:
            flies = status is not None and status.flies_by_setpoints
            # a NaN would remain in all estimator states
            own = self.estimate_own(own, flies, now_s) if own.is_finite else None
        return Inputs(own, status, samples, operator, power, neighbours)

    def _estimate_reserve(self, inputs: Inputs, now_s: float) -> Charge:
        """Estimate the thrust reserve, set this tick's acceleration limits, and return the battery state."""
        own, reserve = inputs.own, self.reserve
        if not reserve.active:
            return reserve.charge
        rise_m_s = own.velocity_enu_m_s[2] if own is not None else 0.0
        flies = own is not None and self.in_free_flight
        reserve.step(inputs.power, inputs.status, rise_m_s, now_s, flies=flies)
        self.velocity.accelerate(reserve.acceleration_max_m_s2)
        return reserve.charge

    def _update_reserve(self, own: OwnState, now_s: float) -> Charge:
        """Return the result of ``_estimate_reserve`` in an ordinary tick; in LANDED the result is ``FIT``."""
        reserve, flies = self.reserve, self.memory.phase is not Phase.LANDED
        if not reserve.active:
            return Charge.FIT
        if not now_s - reserve.reported.arrival_s <= AGE_MAX_S:
            raise NotOrdinary
        reserve.update(own.velocity_enu_m_s[2], self.in_free_flight, flies)
        self.velocity.accelerate(reserve.acceleration_max_m_s2)
        return reserve.charge if flies else Charge.FIT

    def take(self, sample: TargetSample) -> Reading:
        """Check a target sample, and update the target estimate if the sample is accepted."""
        verdict = self.track.accept(sample)
        if verdict is Reading.FRESH:
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

    @property
    def in_free_flight(self) -> bool:
        """Whether the vehicle follows velocity commands away from the support and ground effect of a pad."""
        return self.memory.commanding and self.memory.phase is not Phase.TOUCHDOWN

    def ordinary(self, status: VehicleStatus) -> bool:
        """Whether ``land`` can run the next tick: inputs are trusted, and the vehicle follows set-points."""
        memory, track = self.memory, self.track.memory
        if track.run_since_s < math.inf or track.distrusted or self.plausibility.memory.distrusted:
            return False
        if track.elsewhere is not None:
            return False
        if memory.lifting or memory.yaw_rad is None or not memory.good_since_s < math.inf:
            return False
        if memory.phase is Phase.LANDED:
            return not status.armed
        commanded = memory.was_armed and memory.was_external and not memory.contact
        return memory.phase in FLYING and status.flies_by_setpoints and commanded

    def _message(self, seen: Snapshot, now_s: float) -> MemberStatus | None:
        """Return the message to the neighbours after this tick; None: no neighbours or no valid state."""
        own = seen.inputs.own
        if own is None or not seen.own_ok:
            return None
        return self._fleet.message(
            self.memory, own, seen.inputs.status, self.velocity.base, seen.target, now_s
        )
