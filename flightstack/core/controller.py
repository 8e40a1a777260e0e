"""One tick of the flight stack: ``step(inputs, now) -> outputs`` without I/O, clock or randomness.

newest inputs -> mission machine -> position loop (u') -> CBF program (u*) -> lag correction -> gate

``Controller`` inherits the parts of an ordinary tick from ``LandingKernel`` (``kernel.py``). Live flight,
lockstep simulation and log replay all call ``step``. A simulated campaign computes ordinary ticks with the
compiled ``LandingKernel.land``; its results are equal to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import fields, make_dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from flightstack.core.fleet.member import NO_ROWS
from flightstack.core.kernel import Barriers, LandingKernel
from flightstack.core.memory import FilterMemory, FleetMemory, LateMemory, OwnMemory, ReserveMemory, State
from flightstack.core.mission.guidance import NominalCommand, Situation, nominal_command
from flightstack.core.mission.machine import Transition
from flightstack.core.parameters.filters import FILTERS
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.gate import ApprovedSetpoint, GateVerdict
from flightstack.core.snapshot import Snapshot, snapshot_of
from flightstack.core.strategies.strategy import Filter, strategy_class
from flightstack.core.target.reserve import ReserveEstimate
from flightstack.core.target.track import Verdict
from flightstack.core.types import ZERO, Charge, Inputs, Mode, Neighbour, Phase, Request, Vec3, VehicleStatus


class Event(NamedTuple):
    """Message to the operator; ``level``: severity as in rcl_interfaces/msg/Log."""

    level: int
    text: str


INFO, WARN, ERROR = 20, 30, 40


class Outputs(NamedTuple):
    """Results of one tick, with the inputs and intermediate values that led to them."""

    phase: Phase  # phase after this tick
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
    reserve: float = math.nan  # ratio of maximum thrust to weight; NaN: unknown, or no table [reserve]
    own_message: Neighbour | None = None  # message to the fleet; None: no table [fleet], or no position


def _level(transition: Transition) -> int:
    if transition.after is Phase.ABORT:
        return ERROR
    return WARN if transition.after is Phase.HOLD else INFO


def state_class(config: FlightConfig) -> type[State]:
    """Return the class of the controller state that this configuration needs; logs contain its name."""
    name, parts = "State", dict[str, Any]()
    whole = {"reserve": ReserveMemory, "own": OwnMemory}
    if config.fleet is not None:
        name, parts = "FleetState", {**whole, "fleet": FleetMemory}
    elif config.velocity_loop.dead_time_s > 0.0:
        name, parts = "LateState", {**whole, "late": LateMemory}
    elif config.reserve is not None or config.own.learns:
        name, parts = "WholeState", whole
    if config.filter not in FILTERS and (found := strategy_class(config.filter)).filter is not Filter.filter:
        name, parts["filter"] = "FilterState", FilterMemory
        if found.State is not None:
            parts["filter_state"] = found.State
    return _extended(name, tuple(parts.items())) if parts else State


@lru_cache(maxsize=16)
def _extended(name: str, parts: tuple[tuple[str, Any], ...]) -> type[State]:
    return make_dataclass(name, parts, bases=(State,), slots=True)


class Controller(LandingKernel):
    """Pure flight controller. A step depends only on ``state``, its inputs and the configuration."""

    @property
    def state(self) -> State:
        """Controller state. The next step changes these objects, so log or copy them before it."""
        strategy, estimate, fleet = self.strategy, self.reserve_estimate, self._fleet
        parts = {
            "memory": self.memory, "track": self.track.memory, "motion": strategy.motion,
            "tracking": strategy.tracking, "plausibility": self.plausibility.memory,
            "reserve": estimate.memory if estimate is not None else ReserveMemory(), "own": strategy.own,
            "late": strategy.late, "fleet": fleet.memory,
            "filter": strategy.memory, "filter_state": strategy.state,
        }  # fmt: skip
        kind = state_class(self.config)
        return kind(*(parts[part.name] for part in fields(kind)))

    def restore(self, state: State) -> None:
        """Restore a recorded state."""
        mine = self.state
        for part in fields(mine):
            into, written = getattr(mine, part.name), getattr(state, part.name)
            for each in fields(into):
                setattr(into, each.name, getattr(written, each.name))

    def step(self, inputs: Inputs, now_s: float, *, command_failed: bool = False) -> Outputs:
        """Run one tick: samples, estimates, phase, nominal velocity, filter, gate.

        ``now_s`` is the time of the tick. ``command_failed``: the vehicle rejected the last command.
        """
        memory, strategy, plausibility = self.memory, self.strategy, self.plausibility
        if inputs.own is not None and not inputs.own.is_finite:  # a NaN would remain in all estimator states
            inputs = inputs._replace(own=None)
        self.track.memory.settled = memory.phase is not Phase.WAIT
        events = self._take_samples(inputs)
        track = self.track
        target = strategy.target(track, now_s) if track.memory.last is not None else None
        target_trusted = not track.memory.distrusted
        if target is not None and not target_trusted:
            target = target._replace(velocity_enu_m_s=track.moves_m_s)
        if inputs.own is not None:
            status = inputs.status
            own = self.estimate_own(inputs.own, status is not None and status.flies_by_setpoints, now_s)
            inputs = Inputs(
                own, inputs.status, inputs.target_samples, inputs.operator, inputs.power, inputs.neighbours
            )
        trusted = plausibility.trusts(now_s)
        follows, charge = plausibility.follows, Charge.FIT
        if self.reserve_estimate is not None:
            charge = self._estimate_reserve(self.reserve_estimate, inputs, now_s)
        texts, permissions = self._fleet.observe(inputs, memory.phase, target, now_s)
        events += [Event(WARN, text) for text in texts]
        snapshot = snapshot_of(
            self.config, inputs, target, now_s, trusted=trusted, follows=follows, charge=charge,
            permissions=permissions, target_trusted=target_trusted,
        )  # fmt: skip
        transition = self._mission.step(snapshot, command_failed=command_failed, now_s=now_s)
        if transition is not None:
            events.append(Event(_level(transition), transition.text))
        nominal = nominal_command(Situation(self.config, self.barrier, memory, snapshot, strategy))
        rows, own_message = NO_ROWS, None
        placed = inputs.own if snapshot.own_ok else None
        if nominal.velocity is not None and placed is not None:
            base, most = self.base(placed.velocity_enu_m_s), self.config.limits.velocity_max_m_s
            velocity, rows = self._fleet.beside(memory.phase, placed, base, nominal.velocity, most, now_s)
            if velocity is not nominal.velocity:
                nominal = nominal._replace(velocity=velocity)
        self._rows, self.crowded = rows, bool(rows.rows) or not permissions.may_land
        barrier, wanted, gate, setpoint = self._command(nominal, snapshot)
        why = self.reserve_estimate.text if self.reserve_estimate else ""
        texts = self._fleet.texts(permissions, now_s - memory.phase_since_s, why, now_s)
        events += [Event(WARN, text) for text in texts]
        if placed is not None:
            base = self.base(placed.velocity_enu_m_s)
            own_message = self._fleet.message(memory, placed, inputs.status, base, target, now_s)
        return Outputs(
            phase=memory.phase,
            request=nominal.request,
            setpoint=setpoint,
            gate=gate,
            snapshot=snapshot,
            barrier=barrier,
            wanted=wanted,
            transition=transition,
            events=tuple(events),
            finished=self._finished(inputs.status, now_s),
            target_accepted=self.track.memory.accepted,
            target_rejected=self.track.memory.rejected,
            reserve=self.reserve_estimate.reserve if self.reserve_estimate is not None else math.nan,
            own_message=own_message,
        )

    def _finished(self, status: VehicleStatus | None, now_s: float) -> bool:
        """Return whether the flight is over; a fleet member continues until all other members are down."""
        over = self._mission.finished(status, now_s)
        return over and self._fleet.over(now_s - self.memory.phase_since_s, now_s)

    def _estimate_reserve(self, estimate: ReserveEstimate, inputs: Inputs, now_s: float) -> Charge:
        """Estimate the thrust reserve, set this tick's acceleration limits, and return the battery state."""
        own = inputs.own
        rise_m_s = own.velocity_enu_m_s[2] if own is not None else 0.0
        flies = own is not None and self.in_free_flight
        estimate.step(inputs.power, inputs.status, rise_m_s, now_s, flies=flies)
        self._accelerate(estimate.acceleration_max_m_s2)
        return estimate.charge

    def _take_samples(self, inputs: Inputs) -> list[Event]:
        events = []
        for sample in inputs.target_samples:
            verdict, count = self.take(sample), self.track.memory.rejected
            if verdict is Verdict.ACCEPTED:
                if self.track.stepped_s:
                    by = f"{self.track.stepped_s:+.2f} s"
                    events.append(Event(WARN, f"target: its sender's clock was set by {by}, or began anew"))
            elif not count & (count - 1):  # the event is sent when the count doubles, not for every sample
                so_far = f" ({count} refused so far)" if count > 1 else ""
                events.append(Event(WARN, f"target sample refused: {verdict.text}{so_far}"))
        return events

    def _command(
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
        verdict, approved = self._gate.check(
            wanted,
            setpoint,
            yaw_rad,
            own_fresh=snapshot.own_ok,
            target_fresh=snapshot.target_ok or not nominal.filtered,
            altitude_m=own.position_enu_m[2] if own is not None else math.nan,
            barrier_check=check if nominal.filtered else None,
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
        return barriers, wanted, verdict, approved
