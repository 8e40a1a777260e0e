"""Flies many ordinary ticks of a landing in one call; the final state equals that of single ticks."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any, cast

import numpy as np

from bridge.frames import (
    euler_from_quaternion,
    ned_frd_from_enu_flu,
    yaw_enu_from_ned,
    yaw_ned_from_enu,
)
from bridge.mavlink.client.link import COMPONENT_ID as COMPANION_ID
from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.server.commander import Setpoint
from bridge.mavlink.server.profile import FlightMode
from flightstack.compiled import core
from flightstack.compiled.jit import is_off
from flightstack.compiled.objects import Objects
from flightstack.compiled.records import F64, I64, cell, new, scalars
from flightstack.compiled.tick import RULES
from flightstack.core.controller import FLYING, Controller
from flightstack.core.mission.conditions import lasting_flags
from flightstack.core.numeric import NotOrdinary, hypot_is_known
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.strategy import strategy_class
from flightstack.core.strategies.user_filter import compiled_as
from flightstack.core.types import FilterStatus, OwnState, Phase, Request
from flightstack.onboard.lockstep import VehicleTicks
from sim.plant.states import TRUTH
from sim.runners.landing_wire import PEER
from sim.runners.lockstep import LockstepVehicle
from sim.runners.log import Notes
from sim.runners.robot import DirectTarget
from sim.runners.ticks import BEFORE, MIDDLE, RulesRecord, fly_ticks, look, narrow
from sim.runners.vehicle_node import VehicleNode

TICKS = 20  # maximum number of ticks in one call; the robot is computed for this number of future ticks
SPAN_S = 0.25  # maximum simulated time of one call, s; a longer gap would restart the set-point stream
_SOON_S = 1e-6  # time before a due message in which ticks run in Python, s
SPEED_MAX_M_S = 2.5  # largest set-point on each axis, m/s, that the autopilot surely does not clip
_BACK_OFF = 4  # maximum number of ticks in Python after a failed attempt to start a batch
ASKING = (Phase.APPROACH, Phase.LAND)  # phases in which an agent chooses the nominal velocity


def suited(controller: Controller, node: VehicleNode) -> bool:
    """Whether a landing can fly in batches: compiled code, no faults, supported configuration."""
    return not is_off() and node.vehicle.faults.quiet and suits(controller.config) and hypot_is_known()


def suits(config: FlightConfig) -> bool:
    """Whether compiled kernel and simulated link support everything that a configuration uses."""
    return (
        core.suits_but_filter(config)
        and compiled_as(strategy_class(config.filter)) is not None
        and max(config.limits.velocity_max_m_s) <= SPEED_MAX_M_S
        and (config.checks.target_frame, config.checks.target_child_frame) == ("map", "target")
    )


class Batches:
    """Flies batches of ticks of one landing.

    ``link``, ``ticks``: link and clock of the companion; ``target``: the robot; ``loop``: the vehicle;
    ``ends_s``: time limit of the flight.
    """

    def __init__(
        self,
        controller: Controller,
        link: VehicleLink,
        ticks: VehicleTicks,
        target: DirectTarget,
        loop: LockstepVehicle,
        notes: Notes,
        ends_s: float,
    ) -> None:
        node, grid = loop, loop.grid
        self._controller, self._link, self._ticks, self._target = controller, link, ticks, target
        self._node, self._loop, self._notes, self._grid = node, loop, notes, grid
        self._rules = new(RulesRecord)
        self._rules.ends_s, self._rules.delay_ms = ends_s, loop.radio_ms
        self._rules.status_age_max_s = controller.config.checks.status_age_max_s
        self._strategy = strategy = controller.strategy
        self._asks = strategy.ask is not None or strategy.replaces_program
        self._objects = objects = Objects(controller)
        self._numbers = objects.numbers(strategy)
        self._cells: Any = (
            node.vehicle.cell, cell(self._rules), node.autopilot.flight.watches.cell,
            objects.handle,
        )  # fmt: skip
        self._memory = objects.state, objects.spare
        self._most = max(1, min(TICKS, int(SPAN_S * grid.rate_hz)))
        self._plan = np.array((0, 0, grid.rate_hz, self._rules.delay_ms, 0, 0), dtype=np.int64)
        self._ages, self._told = np.zeros(TICKS), np.zeros(11)
        self._off = False  # whether Python runs all ticks from now on
        self._asked = -1  # newest tick for which the agent or the filter was called
        self._next, self._wait = 0, 1  # first tick of the next attempt; ticks to wait after a failed one
        self._flies, self._yaw_told_rad = False, 0.0
        self._stream_until_s, self._status_s = scalars(self._rules, "stream_until_s", "status_s")
        self._phase = scalars(self._rules, "flies", "lasting", "armed", "standing", "supervisor")
        self._phase_rules = RULES[Phase.LAND]
        self._reserve = controller.reserve
        self._heeded = link.heeded
        self._yaw_rad: float | None = None
        self._clip: tuple[float, float, float] | None = None
        self._sender = (node.autopilot.system_id, COMPANION_ID, PEER)

    @property
    def _given(self) -> Any:
        """First arguments of the compiled functions ``fly_ticks`` and ``look``."""
        return (*self._cells, self._phase_rules, *self._memory, self._plan)

    def warm_up(self) -> None:
        """Compile the code, or load it from the cache."""
        self._plan[1] = 0
        decks, samples, _, come = self._target.ahead(0, 0)
        flown: Any = fly_ticks
        flown(*self._given, decks, samples, come, np.empty((0, TRUTH)), self._ages, self._told)
        if self._asks:
            ends_s, self._rules.ends_s = self._rules.ends_s, -math.inf  # the call flies no tick
            with suppress(NotOrdinary):
                looked: Any = look
                looked(*self._given, samples, np.zeros(1, dtype=np.int64))
            self._rules.ends_s = ends_s

    def fly(self, tick: int) -> int:
        """Fly from ``tick``, the next tick, as far as possible; return the number of ticks flown."""
        if tick != self._asked:
            self._strategy.answer = self._strategy.own_result = None
        if self._off or tick < self._next:
            return 0
        done, until_s = 0, self._quiet_until_s(tick)
        if until_s is None:
            until_s = self._quiet_until_s(tick) if self._speak(tick) else None
        if until_s is None:
            return 0
        if self._prepare() and self._take_power() and self._objects.write():
            while until_s is not None:
                flown, how = self._call(tick + done, until_s)
                done += flown
                if how == BEFORE or flown == 0:
                    break
                until_s = self._quiet_until_s(tick + done)
                if until_s is None and self._speak(tick + done) and self._take_power():
                    if self._reserve.active:
                        self._objects.write_one(self._reserve.reported)
                    until_s = self._quiet_until_s(tick + done)
            if done:
                self._objects.read()
        self._wait = 1 if done else min(2 * self._wait, _BACK_OFF)
        self._next = tick + done + self._wait  # Python runs the tick at which a batch ended
        return done

    def _quiet_until_s(self, tick: int) -> float | None:
        """Return when the next message other than vehicle state and set-point is due, s; None: now."""
        request = Request.EXTERNAL if self._controller.memory.phase in FLYING else Request.NONE
        now_s = self._grid.ns(tick) / 1e9
        until_s = self._link.silent_until_s(request) - _SOON_S
        if not now_s < until_s or not self._loop.undisturbed:
            return None
        until_s = min(until_s, self._node.autopilot.silent_until_s(now_s, self._heeded) - _SOON_S)
        return until_s if now_s < until_s else None

    def _speak(self, tick: int) -> bool:
        """Exchange the messages due at the next tick; return False if the tick has to run in Python.

        These messages are heartbeats and the slow telemetry of the vehicle. They arrive before the
        controller's step, or have no effect on the autopilot, as in a tick in Python.
        """
        node, now_s = self._node, self._grid.ns(tick) / 1e9
        if self._controller.memory.phase not in RULES or not self._loop.undisturbed:
            return False
        messages = node.autopilot.brief(now_s, self._heeded)
        if messages is None:
            return False
        if self._reserve.active:  # an active reserve needs the attitude of this tick
            roll_rad, pitch_rad, _ = euler_from_quaternion(
                ned_frd_from_enu_flu(node.vehicle.estimate().quaternion)
            )
            self._link.state.tilted(narrow(roll_rad), narrow(pitch_rad))
        node.endpoint.send(messages)
        if not self._link.hear(now_s):
            return False
        for received in node.endpoint.receive():
            node.answer(received, now_s)
        status = self._link.state.status
        if status is None:
            return False
        self._status_s[0] = status.arrival_s
        return self._controller.ordinary(status)

    def _prepare(self) -> bool:
        """Store phase and vehicle status; return whether a batch of ticks can run with them."""
        c, rules, status = self._controller, self._rules, self._link.state.status
        memory, flight, vehicle = c.memory, self._node.autopilot.flight, self._node.vehicle
        if status is None or not c.ordinary(status) or memory.yaw_rad is None:
            return False
        if not self._node.watches_nothing or not flight.ground.settled or vehicle.locked:
            return False
        flies, clip = memory.phase in FLYING, flight.pilot.passes_on
        if flies != vehicle.armed or flies == flight.standing:
            return False
        if flies and (flight.mode is not FlightMode.OFFBOARD or clip is None):
            return False
        lasting = lasting_flags(c.config.checks, memory, status)
        whole = (flies, lasting, vehicle.armed, flight.standing, vehicle.supervisor_state)
        for view, number in zip(self._phase, whole, strict=True):
            view[0] = int(number)
        self._phase_rules = RULES[memory.phase]
        self._status_s[0], self._flies = status.arrival_s, flies
        if self._yaw_rad != memory.yaw_rad:
            self._yaw_rad = memory.yaw_rad
            self._yaw_told_rad = yaw = yaw_enu_from_ned(narrow(yaw_ned_from_enu(memory.yaw_rad)))
            rules.yaw_told_rad, rules.cos_yaw, rules.sin_yaw = yaw, math.cos(yaw), math.sin(yaw)
        if clip is not None and clip != self._clip:
            self._clip = clip
            rules.speeds[:] = clip
        return True

    def _take_power(self) -> bool:
        """Store the reported battery and motor state; return False if only Python can handle this report."""
        estimate, power = self._reserve, self._link.state.power
        if not estimate.active:
            return True
        if power is None or (self._flies and estimate.memory.tired):
            return False
        estimate.receive(power, not self._flies)
        return True

    def _call(self, tick: int, until_s: float) -> tuple[int, int]:
        """Fly ticks in one compiled call; return the number of ticks, and the reason why the call ended."""
        node, grid, flight = self._node, self._grid, self._node.autopilot.flight
        asks = self._asks and self._controller.memory.phase in ASKING
        most = 1 if asks else self._most
        count = min(most, max(0, math.ceil((until_s - grid.ns(tick) / 1e9) * grid.rate_hz)))
        while count and not grid.ns(tick + count - 1) / 1e9 < until_s:
            count -= 1
        decks, samples, come_before, come = self._target.ahead(tick, count)
        count = len(come)
        if count == 0 or not node.vehicle.supplied_until(grid.ms(tick + count)):
            return 0, BEFORE
        flies = self._flies
        waits = not flies and flight.mode is FlightMode.OFFBOARD
        self._stream_until_s[0] = flight.stream_ends_s if waits else math.inf
        self._plan[0], self._plan[1], self._plan[4] = tick, count, come_before
        truths = np.empty((count, TRUTH))
        if asks and not self._ask(tick, samples, come):
            return 0, BEFORE
        try:
            flown: Any = fly_ticks
            how = flown(*self._given, decks, samples, come, truths, self._ages, self._told)
        except NotOrdinary:
            how = BEFORE
            self._objects.state[:] = self._objects.spare
        done = int(self._plan[5])
        if done == 0:
            return 0, how
        self._strategy.answer = self._strategy.own_result = None
        last = tick + done - 1
        times_ns = [grid.ns(each) for each in range(tick, last + 1)]
        now_s = times_ns[-1] / 1e9
        self._notes.batch(tick, times_ns, self._controller.memory.phase, self._ages[:done], truths[:done])
        self._target.skip(done)
        self._ticks.passed(times_ns[-1])
        node.autopilot.streams.skip([each / 1e9 for each in times_ns])
        x, y, z, vx, vy, vz, yaw, source_s, ux, uy, uz = self._told.tolist()
        self._link.took(OwnState(now_s, source_s, (x, y, z), (vx, vy, vz), yaw), done, setpoints=flies)
        setpoint = Setpoint((ux, uy, uz), self._yaw_told_rad, 0.0) if flies else None
        ahead_ms = min(grid.ms(last + 1) - grid.ms(last), self._loop.radio_ms)
        node.vehicle.sent_before_ms = ahead_ms
        if how != MIDDLE:
            flight.flown(now_s, setpoint, self._sender)
            node.vehicle.flown(grid.ms(last + 1))
            return done, how
        if done > 1:
            flight.flown(times_ns[-2] / 1e9, setpoint, self._sender)
        node.vehicle.flown(grid.ms(last) + ahead_ms)
        if setpoint is not None:
            flight.take_setpoint(setpoint, self._sender, now_s)
        node.control(now_s)
        node.vehicle.advance(grid.ms(last + 1) - grid.ms(last) - ahead_ms)
        return done, how if self._goes_on(flies) else BEFORE

    def _ask(self, tick: int, samples: F64, come: I64) -> bool:
        """Request the next velocity from agent or filter; return False if Python has to run this tick."""
        objects, strategy, looked = self._objects, self._strategy, cast("Any", look)
        try:
            at, command, asked = looked(*self._given, samples, come)
        except NotOrdinary:
            return False
        finally:
            objects.state[:] = objects.spare
        nominal, h_m, gradient, dh_dt_m_s, lower, upper = asked
        self._controller.memory.command, self._asked = command, tick
        if strategy.ask is not None:
            strategy.answer = strategy.exchange.chosen = strategy.ask(at, nominal)
        else:
            refusal = strategy.memory.refusal
            result = strategy.filtered(at, h_m, gradient, dh_dt_m_s, nominal, lower, upper)
            strategy.own_result = result, strategy.memory.refusal
            strategy.memory.refusal = refusal  # the mission reads the new refusal in the next tick
            # a filter that changes other fields of its class flies in Python from now on
            self._off = objects.numbers(strategy) != self._numbers
            if result.status is FilterStatus.REJECTED or self._off:
                return False
            strategy.exchange.chosen = result.velocity_enu_m_s
        objects.write_one(strategy.exchange)
        return True

    def _goes_on(self, flies: bool) -> bool:
        """Whether mode, arming and ground contact are the same as in the batch."""
        flight, vehicle = self._node.autopilot.flight, self._node.vehicle
        mode = flight.mode is FlightMode.OFFBOARD or not flies
        return mode and vehicle.armed == flies and flight.standing != flies and flight.ground.settled
