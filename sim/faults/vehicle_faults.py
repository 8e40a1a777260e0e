"""All faults of one vehicle: by schedule and by command, with texts.

This code runs only while a fault starts, ends or is active; the compiled loop has only two numbers a motor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Protocol

from flightstack.core.types import Vec3
from sim.faults.drive import BatteryFaults, MotorFaults
from sim.faults.link import CONCERNS, LinkFaults
from sim.faults.mavlink import OK, PARTS, faults_of, motors_of
from sim.faults.samples import EstimateFaults, SampleFaults, Shape
from sim.faults.schedule import RUNNING_MAX, Change, FaultText, Running, Schedule
from sim.scenarios.fault_spec import After, Fault, What

TEXTS_MAX = 256  # texts kept until ``take_texts``; the oldest are dropped

MocapSample = tuple[float, ...]  # x, y, z (ENU, m), yaw (rad)


class Effect(Protocol):
    """Applies the faults of one part."""

    def begin(self, running: Running) -> None: ...

    def end(self, running: Running, now_ns: int) -> None: ...


def _move_mocap(sample: MocapSample, offset: Vec3, turn: float) -> MocapSample:
    x, y, z, yaw = sample
    return (x + offset[0], y + offset[1], z + offset[2], math.remainder(yaw + turn, math.tau))


MOCAP: Shape[MocapSample] = Shape(_move_mocap, lambda first, _: first)


class Faults:
    """Schedule and effects; faults of the robot are ignored."""

    def __init__(
        self, faults: Iterable[Fault], seed: int, motors: MotorFaults, battery: BatteryFaults
    ) -> None:
        self._schedule = Schedule(seed)
        ours = [fault for fault in faults if not fault.of_the_robot]
        self._schedule.add(ours)
        self.quiet = not ours  # there was no fault and none is planned
        self.mocap = SampleFaults(MOCAP)  # motion capture on its way to the estimator
        self.own_state = EstimateFaults()  # the estimate on its way to the autopilot
        self.link = LinkFaults()  # for the owner of the MAVLink wire
        self._effects: dict[What, Effect] = {
            What.MOTOR: motors,
            What.BATTERY: battery,
            What.MOCAP: self.mocap,
            What.OWN_STATE: self.own_state,
            **dict.fromkeys(CONCERNS, self.link),
        }
        self._texts: deque[FaultText] = deque(maxlen=TEXTS_MAX)

    @property
    def next_ns(self) -> int:
        """Time of the next start, end, delayed or due sample."""
        return min(self._schedule.next_ns, self.mocap.release_ns, self.own_state.due_ns)

    @property
    def waits_for_takeoff(self) -> bool:
        """Whether ``took_off`` has to be called at the take-off."""
        return self._schedule.waits_for(After.TAKEOFF)

    def took_off(self, now_ns: int) -> None:
        """The vehicle flies for the first time."""
        self._schedule.refer(After.TAKEOFF, now_ns)

    def run(self, now_ns: int) -> None:
        """Start and end due faults."""
        for change in self._schedule.due(now_ns):
            self._apply(change, now_ns)

    def inject(self, unit: int, kind: int, instance: int, now_ns: int) -> str | None:
        """MAV_CMD_INJECT_FAILURE; returns the reason of a rejection. OK also heals scheduled faults."""
        found = faults_of(unit, kind, instance)
        if isinstance(found, str):
            return found
        if kind == OK:
            self._heal(unit, instance, now_ns)
            return None
        active = {running.fault for running in self._schedule.active}
        fresh = [fault for fault in found if fault not in active]  # a repeated command
        if len(active) + len(fresh) > RUNNING_MAX:
            return f"{len(active)} faults are on, at most {RUNNING_MAX} are possible; heal some"
        self.fail(fresh, now_ns)
        return None

    def fail(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Start faults now, those with a time after ``time`` at least."""
        self.quiet = False
        self._schedule.add(faults, now_ns)
        self.run(now_ns)

    def take_texts(self) -> list[FaultText]:
        """Texts on starts and ends since the last call."""
        if not self._texts:
            return []
        texts = list(self._texts)
        self._texts.clear()
        return texts

    def _heal(self, unit: int, instance: int, now_ns: int) -> None:
        motors = motors_of(unit, instance)
        for running in self._schedule.active:
            fault = running.fault
            meant = fault.what in PARTS[unit] and (fault.motor is None or fault.motor in motors)
            if meant and fault.cell.healable:
                self._apply(self._schedule.heal(running), now_ns)

    def _apply(self, change: Change, now_ns: int) -> None:
        running, begins = change
        effect = self._effects[running.fault.what]
        if begins:
            effect.begin(running)
        else:
            effect.end(running, now_ns)
        self._texts.append(FaultText(begins, running.fault.text))
