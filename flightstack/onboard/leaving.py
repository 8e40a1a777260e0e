"""Requests of the operator, and the decision whether a flight has ended."""

from __future__ import annotations

import signal
import time
from typing import NamedTuple

from flightstack.common.hangup import begun, handle
from flightstack.core.controller import Outputs
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Operator, Phase, VehicleStatus

LAND_SHOWN_MAX_S = 1.0  # time for which a landing command is repeated without a confirming heartbeat, s


class Ended(NamedTuple):
    """Result of a flight: last phase, its reason, and the exit status of the process."""

    phase: Phase
    reason: str
    exit_code: int


class Person:
    """Requests of the operator to the process; this base class makes none."""

    operator = Operator.NONE  # newest request of the operator
    stop = False  # whether the process must end immediately
    _seen_s: float | None = None  # wall time at which ``left`` first detected the stop, s

    def left(self) -> bool:
        """Whether ``LAND_SHOWN_MAX_S`` has passed since the process had to end; until then ticks can run."""
        if not self.stop:
            return False
        now_s = time.monotonic()
        if self._seen_s is None:
            self._seen_s = now_s
        return now_s - self._seen_s >= LAND_SHOWN_MAX_S


class Signals(Person):
    r"""Signals of the operator: Ctrl-C or a closed terminal requests an abort, Ctrl-\ an emergency stop.

    A second Ctrl-C, or SIGTERM, ends the process after the vehicle was commanded to land.
    """

    def __init__(self) -> None:
        handle(
            {
                signal.SIGINT: self._interrupt,
                signal.SIGTERM: self._terminate,
                signal.SIGQUIT: self._emergency,
                signal.SIGHUP: self._abort,
            }
        )
        begun()

    def _interrupt(self) -> None:
        self.stop = self.operator is not Operator.NONE
        self._abort()

    def _abort(self) -> None:
        self.operator = max(self.operator, Operator.ABORT)

    def _emergency(self) -> None:
        self.operator = Operator.EMERGENCY_STOP

    def _terminate(self) -> None:
        self.stop = True


class Leaving:
    """Decision whether a flight has ended: call ``operator`` before each step and ``ended`` after it.

    ``duration_s``: time on the stack's clock after which the flight is aborted; None: no limit.
    """

    def __init__(self, duration_s: float | None, person: Person | None = None) -> None:
        self._duration_s, self.person = duration_s, person or Person()
        self.leaves = False  # whether the process is about to end and therefore requests a landing
        self.arms = False  # whether the vehicle was commanded to arm
        self._theirs = False  # whether another client controls the vehicle while this process waits

    def operator(self, status: VehicleStatus | None, now_s: float) -> Operator:
        """Return the operator's request in this tick; ``status``: newest status of the vehicle."""
        requested = self.person.operator
        if requested is Operator.EMERGENCY_STOP or status is None or not status.armed:
            return requested
        if self.leaves:
            return Operator.LAND
        if self._theirs:
            return Operator.NONE
        return Operator.TIME_OVER if self._time_over(now_s) and requested is Operator.NONE else requested

    def ended(self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float) -> Ended | None:
        """Return how the flight ended with the outputs of this tick; None if it has not ended."""
        if out.finished:
            suffix = f"; {self._duration_s:g} s are over" if self._time_over(now_s) else ""
            return Ended(out.phase, memory.reason + suffix, 0 if out.phase is Phase.LANDED else 1)
        armed = status is not None and status.armed
        self.arms = self.arms or memory.phase not in (Phase.WAIT, Phase.ABORT)
        self._theirs = armed and memory.phase is Phase.WAIT and not memory.was_external
        if self.person.stop or (self._theirs and self.person.operator is Operator.ABORT):
            return Ended(out.phase, "ended by the operator", 1)
        if self._time_over(now_s) and not flies(memory, status):
            return Ended(out.phase, f"{self._duration_s:g} s are over", 1)
        return None

    def _time_over(self, now_s: float) -> bool:
        return self._duration_s is not None and now_s >= self._duration_s


def flies(memory: Memory, status: VehicleStatus | None) -> bool:
    """Whether, by its newest status, the vehicle is in the air and under the control of this process."""
    if status is None or not status.armed or memory.abort_way is AbortWay.HANDS_OFF:
        return False
    if memory.phase is Phase.LANDED:  # the motors are off, and this process has not armed the vehicle again
        return False
    return memory.phase is not Phase.WAIT or memory.was_external
