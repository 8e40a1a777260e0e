"""Controller whose ordinary landing ticks are compiled from the source of ``Controller.land``.

The set-points, states and log rows of a compiled tick equal those of plain Python to the last bit; a replay
of a flight's log in plain Python verifies this. All other ticks run in Python. Nothing is compiled in flight.
"""

from __future__ import annotations

import math
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from flightstack.compiled.foreign import call, doubles, whole
from flightstack.compiled.jit import jitted
from flightstack.compiled.objects import Objects
from flightstack.compiled.records import F64
from flightstack.core.controller import Controller, Landing, Outputs
from flightstack.core.memory import Memory, State
from flightstack.core.numeric import STAND_INS, NotOrdinary
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.osqp import Osqp, calls
from flightstack.core.safety.qp_filter import FilterResult
from flightstack.core.sender_clock import Reading
from flightstack.core.snapshot import FUTURE_MAX_S, Relative, Snapshot
from flightstack.core.strategies.strategy import Filter
from flightstack.core.strategies.user_filter import NOWHERE
from flightstack.core.types import (
    ZERO,
    FilterStatus,
    Inputs,
    Operator,
    OwnState,
    Phase,
    Request,
    TargetSample,
    Vec3,
    VehicleStatus,
)

_SAMPLES = 4  # maximum number of target samples in a compiled tick
_OWN, _SAMPLE = struct.Struct("=11d"), struct.Struct("=10d")
_NONE = -1.0  # value in place of the number of samples in a call that only compiles


def _solve(one: Osqp, numbers: tuple[float, ...]) -> tuple[Vec3, bool, int]:
    """Compiled form of ``Osqp.solve``."""
    memory = doubles(one.numbers)
    for i in range(len(numbers)):
        memory[i] = numbers[i]
    vectors, matrix, start, run = calls(one.rows, one.solver, one.numbers)
    call(one.update_vectors, vectors)
    call(one.update_matrix, matrix)
    call(one.warm_start, start)
    call(one.run, run)
    found, iterations = doubles(one.solution), whole(one.iterations) + 0
    point = (found[0], found[1], found[2])
    solved = whole(one.status) == one.solved and math.isfinite(point[0] + point[1] + point[2])
    return point, solved, iterations


def _chosen(one: Filter, at: Relative, own: Vec3) -> Vec3:
    """Compiled form of ``Filter.choose``: call the agent."""
    exchange = one.exchange
    if not exchange.agent:
        return own
    exchange.at, exchange.nominal = at, own
    if call(exchange.function, ()) != 0:
        raise NotOrdinary
    return exchange.chosen


def _filtered(
    one: Filter, at: Relative, h_m: float, gradient: Vec3, dh_dt_m_s: float, nominal: Vec3, lower: Vec3,
    upper: Vec3,
) -> FilterResult:  # fmt: skip
    """Compiled form of ``Filter.filtered``: call the user's filter."""
    exchange = one.exchange
    exchange.at, exchange.nominal, exchange.lower_m_s, exchange.upper_m_s = at, nominal, lower, upper
    exchange.h_m, exchange.gradient, exchange.dh_dt_m_s = h_m, gradient, dh_dt_m_s
    if call(exchange.function, ()) != 0:
        raise NotOrdinary
    return FilterResult(exchange.chosen, 0.0, False, FilterStatus.OWN, 0.0, 0, 0.0)


STAND_INS[Osqp.solve] = _solve
STAND_INS[Filter.choose], STAND_INS[Filter.filtered] = _chosen, _filtered


@jitted
def take(kernel: Controller, row: F64, arrival_s: float) -> None:
    """Pass a sample of the target to the controller.

    ``row``: stamp, position, velocity, yaw, yaw rate of the sample.
    Raises NotOrdinary: the sample is not accepted, or the clock of its sender was set.
    """
    checks = kernel.config.checks
    sample = TargetSample(
        arrival_s, row[0], checks.target_frame, checks.target_child_frame, (row[1], row[2], row[3]),
        (row[4], row[5], row[6]), row[7], row[8], 0.0, 0.0,
    )  # fmt: skip
    if kernel.take(sample) is not Reading.FRESH or kernel.track.stepped_s != 0.0:
        raise NotOrdinary


@dataclass(slots=True)
class Answer:
    """Result of a compiled tick."""

    landing: Landing
    reserve: float = math.nan  # thrust reserve: maximum thrust divided by the weight


@jitted
def _land(kernel: CompiledController, given: F64) -> None:
    """Pass the samples to the controller and run a tick."""
    if given[0] == _NONE:
        raise NotOrdinary
    kernel.track.memory.settled = True  # ``step`` sets ``settled`` from the take-off on
    for n in range(int(given[0])):
        row = given[11 + 10 * n : 21 + 10 * n]
        take(kernel, row, row[9])
    own = OwnState(
        given[2], given[3], (given[4], given[5], given[6]), (given[7], given[8], given[9]), given[10]
    )
    kernel.answer.landing, kernel.answer.reserve = kernel.land(own, given[1]), kernel.reserve.reserve


class CompiledController(Controller):
    """Controller that computes an ordinary landing tick in one compiled call.

    The first access to ``memory`` or ``state`` after a tick copies the state back to Python's objects.
    """

    answer: Answer

    def __init__(self, config: FlightConfig) -> None:
        # whether compiled memory holds the newest state; whether Python's objects are older than this state
        self._held = self._behind = False
        super().__init__(config)
        self.answer = Answer(Landing(False, NOWHERE, self.velocity.unsent(NOWHERE), ZERO, ZERO))
        self._objects = Objects(self)
        self._given = np.zeros(11 + 10 * _SAMPLES)
        self._status: object = ()
        self._accepted = 0
        self._given[0] = _NONE
        land: Any = _land
        with suppress(NotOrdinary):
            land(self._objects, self._given)
        # entry point for calls without numba's dispatcher, which needs 2 us for the types of the arguments
        self._land = land.overloads[self._objects.kind, land.typeof_pyval(self._given)].entry_point

    @property
    def memory(self) -> Memory:
        """State of the mission and of the commands."""
        if self._behind:
            self._objects.read()
            self._behind = False
        return self._memory

    @memory.setter
    def memory(self, memory: Memory) -> None:
        self._memory = memory

    def restore(self, state: State) -> None:
        """Replace the state by a recorded one; the next tick continues from it."""
        super().restore(state)
        self._held = False

    def step(self, inputs: Inputs, now_s: float, *, command_failed: bool = False) -> Outputs:
        """Run one tick, compiled if it is ordinary, else in Python."""
        out = None if command_failed else self._ordinary_tick(inputs, now_s)
        if out is None:
            out = super().step(inputs, now_s, command_failed=command_failed)
            self._held = False
        return out

    def _ordinary_tick(self, inputs: Inputs, now_s: float) -> Outputs | None:
        """Run a compiled tick and return its outputs; None: not ordinary, and the state is unchanged."""
        own, status, samples = inputs.own, inputs.status, inputs.target_samples
        if own is None or status is None or not self._holds(status):
            return None
        checks = self.config.checks
        young = -FUTURE_MAX_S <= now_s - own.arrival_s <= checks.own_age_max_s
        heard = now_s - status.arrival_s <= checks.status_age_max_s
        if not (young and heard and own.is_finite) or inputs.operator is not Operator.NONE:
            return None
        frames = checks.target_frame, checks.target_child_frame
        if len(samples) > _SAMPLES or any(
            (each.frame_id, each.child_frame_id) != frames or each.position_sigma_m or each.velocity_sigma_m_s
            for each in samples
        ):
            return None
        reserve, objects, given = self.reserve, self._objects, self._given
        if reserve.active and reserve.receive(inputs.power, standing=False):
            objects.write_one(reserve.reported)
        _OWN.pack_into(
            given.data, 0, len(samples), now_s, own.arrival_s, own.source_time_s, *own.position_enu_m,
            *own.velocity_enu_m_s, own.yaw_rad,
        )  # fmt: skip
        for n, each in enumerate(samples):
            _SAMPLE.pack_into(
                given.data, _OWN.size + n * _SAMPLE.size, each.source_time_s, *each.position_enu_m,
                *each.velocity_enu_m_s, each.yaw_rad, each.yaw_rate_rad_s, each.arrival_s,
            )  # fmt: skip
        objects.spare[:] = objects.state
        began_s = time.perf_counter()
        try:
            self._land(self._objects, given)
        except NotOrdinary:
            objects.state[:] = objects.spare
            return None
        took_s = time.perf_counter() - began_s
        self._behind = True
        self._accepted += len(samples)
        objects.read_one(self.answer)
        return self._outputs(inputs, took_s)

    def _holds(self, status: VehicleStatus) -> bool:
        """Whether compiled memory holds the state, and an ordinary tick is possible with this status."""
        known = status.armed, status.mode, status.landed
        if self._held and known == self._status:
            return True
        memory = self.memory
        if memory.phase is Phase.LANDED or not self.ordinary(status):
            return False
        self._held = self._held or self._objects.write()
        self._status, self._accepted = known, self.track.memory.accepted
        return self._held

    def _outputs(self, inputs: Inputs, took_s: float) -> Outputs:
        """Return the outputs as ``Controller.step`` does; the gate checks the velocity again."""
        (_, at, barriers, wanted, setpoint), memory = self.answer.landing, self._memory
        if barriers.result.iterations:
            result = FilterResult._make((*barriers.result[:-1], took_s))
            barriers = barriers._replace(result=result)
        verdict, approved = self.velocity.gate.check(
            wanted, setpoint, memory.yaw_rad or 0.0,
            own_fresh=True, target_fresh=True, altitude_m=at.own.position_enu_m[2], barrier_check=None,
        )  # fmt: skip
        known = Inputs(
            at.own, inputs.status, inputs.target_samples, inputs.operator, inputs.power, inputs.neighbours
        )
        snapshot = Snapshot(known, at.target, True, True, True, at)
        return Outputs(
            memory.phase, Request.EXTERNAL, approved, verdict, snapshot, barriers, wanted, None, (), False,
            self._accepted, self.track.memory.rejected, self.answer.reserve, None,
        )  # fmt: skip
