"""Flies many ordinary ticks of a landing in one call; the final state equals that of single ticks."""

from __future__ import annotations

import contextlib
import ctypes
import math
from typing import Any

import numpy as np

from bridge.frames import (
    euler_from_quaternion,
    ned_frd_from_enu_flu,
    yaw_enu_from_ned,
    yaw_ned_from_enu,
)
from bridge.mavlink.client.link import COMPONENT_ID as COMPANION_ID
from bridge.mavlink.server.commander import Setpoint
from bridge.mavlink.server.profile import FlightMode
from flightstack.compiled import core
from flightstack.compiled.jit import is_off
from flightstack.compiled.objects import Objects
from flightstack.compiled.records import cell, new, scalars
from flightstack.core.controller import Controller
from flightstack.core.mission.phases import FLYING, ORDINARY
from flightstack.core.numeric import NotOrdinary, hypot_is_known
from flightstack.core.strategies.strategy import strategy_class
from flightstack.core.strategies.user_filter import compiled_as
from flightstack.core.types import FilterStatus, OwnState, Request
from flightstack.onboard.lockstep import VehicleTicks
from sim.plant.states import TRUTH
from sim.runners.landing_wire import PEER
from sim.runners.lockstep import LockstepVehicle
from sim.runners.log import Notes
from sim.runners.robot import DirectTarget
from sim.runners.ticks import BEFORE, MIDDLE, BatchRecord, decided, fly_ticks, narrow
from sim.runners.vehicle_node import VehicleNode

TICKS = 25  # maximum number of ticks in one call; the robot is computed for this number of future ticks
SPAN_S = 0.25  # maximum simulated time of one call, s; a longer gap would restart the set-point stream
_SOON_S = 1e-6  # time before a due message during which ticks run in Python, s
SPEED_MAX_M_S = 2.5  # speed on each axis, m/s, up to which the autopilot surely does not clip a set-point
_BACK_OFF = 4  # maximum number of ticks in Python after calls without a flown tick


def suited(controller: Controller, node: VehicleNode) -> bool:
    """Whether a landing can fly in batches: compiled code, no faults, supported configuration and link."""
    config = controller.config
    return (
        not is_off()
        and node.vehicle.faults.quiet
        and core.suits_but_filter(config)
        and compiled_as(strategy_class(config.filter)) is not None
        and max(config.limits.velocity_max_m_s) <= SPEED_MAX_M_S
        and (config.checks.target_frame, config.checks.target_child_frame) == ("map", "target")
        and hypot_is_known()
    )


class Batches:
    """Flies batches of ticks of one landing.

    ``ticks``: clock and link of the companion; ``target``: the robot; ``node``: the vehicle; ``ends_s``: time
    limit of the flight, s.
    """

    def __init__(
        self, controller: Controller, ticks: VehicleTicks, target: DirectTarget, node: LockstepVehicle,
        notes: Notes, ends_s: float,
    ) -> None:  # fmt: skip
        grid, strategy = node.grid, controller.strategy
        self._controller, self._link, self._ticks, self._target = controller, ticks.link, ticks, target
        # ids of the messages that the companion uses, and of those that do not only repeat known values; both
        # sets depend on the autopilot's profile, which is known from the start
        self._heeded = ticks.link.heeded
        self._news = self._heeded - ticks.link.state.repeated
        self._node, self._notes, self._grid = node, notes, grid
        self._strategy, self._reserve = strategy, controller.reserve
        self._batch = batch = new(BatchRecord)
        batch.rate_hz, batch.radio_ms, batch.ends_s = grid.rate_hz, node.radio_ms, ends_s
        strategy.exchange.agent = strategy.ask is not None
        if strategy.ask is not None or strategy.replaces_program:
            self._function = ctypes.CFUNCTYPE(ctypes.c_int)(self._ask)  # compiled code has only its address
            strategy.exchange.function = ctypes.cast(self._function, ctypes.c_void_p).value or 0
        self._objects = objects = Objects(controller)
        self._numbers = objects.numbers(strategy)
        self._given: Any = (
            node.vehicle.cell, cell(batch), node.autopilot.flight.watches.cell, objects,
            objects.state, objects.spare,
        )  # fmt: skip
        self._most = max(1, min(TICKS, int(SPAN_S * grid.rate_hz)))
        self._ages = np.zeros(TICKS)
        # views of fields, because access to an attribute of a record is slow
        self._plan, self._own_sent, self._setpoint = batch.plan, batch.own_sent, batch.setpoint
        self._stream_until_s, self._status_s = scalars(batch, "stream_until_s", "status_s")
        self._flies, self._yaw_rad = False, 0.0
        self._off = False  # whether Python runs all ticks from now on
        self._asked_s = math.nan  # time of the newest tick that called an agent or a user's filter, s
        self._raised: BaseException | None = None  # exception of an agent or a user's filter
        self._next, self._wait = 0, 1  # first tick of the next attempt; ticks to wait after a failed call
        self._sender = (node.autopilot.system_id, COMPANION_ID, PEER)

    def warm_up_controller(self) -> None:
        """Compile the controller's part of the code by a call that ends at once, since the flight is over."""
        run: Any = decided
        with contextlib.suppress(NotOrdinary):
            run(self._node.vehicle.record, self._batch, self._objects, np.empty((0, 9)), math.inf)

    def warm_up(self) -> None:
        """Compile the code, or load it from the cache."""
        self._plan[1] = 0
        decks, samples, _, come = self._target.ahead(0, 0)
        flown: Any = fly_ticks
        flown(*self._given, decks, samples, come, np.empty((0, TRUTH)), self._ages)

    def fly(self, tick: int) -> int:
        """Fly from ``tick``, the next tick, as far as possible; return the number of ticks flown."""
        done = 0
        if self._asked_s != self._grid.ns(tick) / 1e9:  # a repeated tick reuses the answer
            self._strategy.answer = self._strategy.own_result = None
        if self._off or tick < self._next or self._controller.memory.phase not in ORDINARY:
            return 0
        tried = False
        while (until_s := self._until_s(tick + done)) is not None and self._take_power():
            if done == 0 and not (self._prepare() and self._objects.write()):
                break
            tried = True
            flown, how = self._call(tick + done, until_s)
            done += flown
            if how == BEFORE or flown == 0:
                break
        if done:
            self._objects.read()
        self._wait = min(2 * self._wait, _BACK_OFF) if tried and not done else 1
        self._next = tick + done + self._wait  # Python runs the tick at which a batch ended
        return done

    def _until_s(self, tick: int) -> float | None:
        """Return the time until which only states and set-points are sent, s; None: ``tick`` needs Python."""
        until_s = self._quiet_until_s(tick)
        return self._quiet_until_s(tick) if until_s is None and self._speak(tick) else until_s

    def _quiet_until_s(self, tick: int) -> float | None:
        """Return the due time, s, of the next message except state and set-point; None: due now."""
        request = Request.EXTERNAL if self._controller.memory.phase in FLYING else Request.NONE
        now_s = self._grid.ns(tick) / 1e9
        until_s = self._link.silent_until_s(request) - _SOON_S
        if not now_s < until_s or not self._node.undisturbed:
            return None
        until_s = min(until_s, self._node.autopilot.silent_until_s(now_s, self._news) - _SOON_S)
        return until_s if now_s < until_s else None

    def _speak(self, tick: int) -> bool:
        """Exchange the messages due at the next tick; return False if the tick has to run in Python.

        These messages are heartbeats and the slow telemetry of the vehicle. They arrive before the
        controller's step, or have no effect on the autopilot, as in a tick in Python.
        """
        node, now_s = self._node, self._grid.ns(tick) / 1e9
        if self._controller.memory.phase not in ORDINARY or not self._node.undisturbed:
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
        c, batch, status = self._controller, self._batch, self._link.state.status
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
        self._flies = batch.flies = flies
        batch.status_s, batch.supervisor = status.arrival_s, vehicle.supervisor_state
        self._yaw_rad = batch.yaw_rad = yaw_rad = yaw_enu_from_ned(narrow(yaw_ned_from_enu(memory.yaw_rad)))
        batch.cos_yaw, batch.sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
        if clip is not None:
            batch.speeds[:] = clip
        return True

    def _take_power(self) -> bool:
        """Store the reported battery and motor state; return False if only Python can handle this report."""
        estimate, power = self._reserve, self._link.state.power
        if not estimate.active:
            return True
        flies = self._controller.memory.phase in FLYING
        if power is None or (flies and estimate.memory.tired):
            return False
        if estimate.receive(power, not flies):
            self._objects.write_one(estimate.reported)
        return True

    def _call(self, tick: int, until_s: float) -> tuple[int, int]:
        """Fly ticks in one compiled call; return the number of ticks, and the reason why the call ended."""
        node, grid, flight, flies = self._node, self._grid, self._node.autopilot.flight, self._flies
        count = min(self._most, max(0, math.ceil((until_s - grid.ns(tick) / 1e9) * grid.rate_hz)))
        while count and not grid.ns(tick + count - 1) / 1e9 < until_s:
            count -= 1
        decks, samples, come_before, come = self._target.ahead(tick, count)
        count = len(come)
        if count == 0 or not node.vehicle.supplied_until(grid.ms(tick + count)):
            return 0, BEFORE
        waits = not flies and flight.mode is FlightMode.OFFBOARD
        self._stream_until_s[0] = flight.stream_ends_s if waits else math.inf
        self._plan[:3] = tick, count, come_before
        truths = np.empty((count, TRUTH))
        try:
            flown: Any = fly_ticks
            how = flown(*self._given, decks, samples, come, truths, self._ages)
        except NotOrdinary:
            if self._raised is not None:
                raise self._raised from None
            how = BEFORE
            self._objects.state[:] = self._objects.spare
            self._objects.read()
        done = int(self._plan[3])
        if done == 0:
            return 0, how
        last = tick + done - 1
        times_ns = [grid.ns(each) for each in range(tick, last + 1)]
        now_s = times_ns[-1] / 1e9
        self._notes.batch(tick, times_ns, self._controller.memory.phase, self._ages[:done], truths[:done])
        self._target.skip(done)
        self._ticks.passed(times_ns[-1])
        passed = node.autopilot.streams.skip([each / 1e9 for each in times_ns])
        source_s, x, y, z, vx, vy, vz, yaw_rad = self._own_sent.tolist()
        own = OwnState(now_s, source_s, (x, y, z), (vx, vy, vz), yaw_rad)
        self._link.took(own, done, passed, setpoints=flies)
        ux, uy, uz = self._setpoint.tolist()
        setpoint = Setpoint((ux, uy, uz), self._yaw_rad, 0.0) if flies else None
        ahead_ms = min(grid.ms(last + 1) - grid.ms(last), node.radio_ms)
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
        # whether mode, arming and ground contact are still as assumed for the batch
        same = (flight.mode is FlightMode.OFFBOARD or not flies) and node.vehicle.armed == flies
        return done, how if same and flight.standing != flies and flight.ground.settled else BEFORE

    def _ask(self) -> int:
        """Request a velocity from an agent or a user's filter; compiled code calls this within a tick.

        Return 0, or 1 if Python has to run this tick.
        """
        objects, strategy = self._objects, self._strategy
        given, strategy.own_result, refusal = strategy.exchange, None, strategy.memory.refusal
        objects.read()
        self._asked_s = given.at.own.arrival_s
        try:
            if strategy.ask is not None:
                strategy.answer = given.chosen = strategy.ask(given.at, given.nominal)
            else:
                result = strategy.filtered(
                    given.at, given.h_m, given.gradient, given.dh_dt_m_s, given.nominal, given.lower_m_s,
                    given.upper_m_s,
                )  # fmt: skip
                strategy.own_result, given.chosen = (result, strategy.memory.refusal), result.velocity_enu_m_s
                strategy.memory.refusal = refusal  # the mission reads the new refusal in the next tick
                # a filter that changes other fields of its class flies in Python from now on
                self._off = objects.numbers(strategy) != self._numbers
                if result.status is FilterStatus.REJECTED or self._off:
                    return 1
        except BaseException as error:  # compiled code cannot pass an exception on
            self._raised = error
            return 1
        objects.write_one(given)
        return 0
