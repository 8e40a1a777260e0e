"""Requests of the operator, and the end of a flight: every flight ends in ``fly``."""

from __future__ import annotations

import contextlib
import signal
import time
import traceback
from collections.abc import Callable

from flightstack.common.hangup import begun, handle
from flightstack.core.controller import Outputs
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.parameters.filters import failed_in
from flightstack.core.types import Mode, Operator, Phase, Request, VehicleStatus
from flightstack.onboard.runner import ClockStoppedError, Ended, LinkedVehicle, Runner

_PERIOD_S = 0.02  # wall time between two checks after the last tick, s
LAND_SHOWN_MAX_S = 1.0  # longest repetition of the landing command without a confirming heartbeat, s


class Person:
    """Requests of the operator to the process; this base class makes none."""

    operator = Operator.NONE  # newest request of the operator
    stop = False  # whether the process must end immediately
    _seen_s: float | None = None  # wall time at which ``left`` first detected the stop, s

    def left(self) -> bool:
        """Whether a process that ends has waited ``LAND_SHOWN_MAX_S`` for further ticks."""
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
    """Decision when a flight ends: call ``operator`` before each step and ``ended`` after it.

    ``duration_s``: time on the stack's clock after which the flight is aborted; None: no limit.
    """

    def __init__(self, duration_s: float | None, person: Person | None = None) -> None:
        self._duration_s, self.person = duration_s, person or Person()
        self.leaves = False  # whether the process is about to end and therefore requests a landing
        self.arms = False  # whether the vehicle was commanded to arm
        self._theirs = False  # whether another client controls the vehicle and the process waits

    def operator(self, status: VehicleStatus | None, now_s: float) -> Operator:
        """Return the operator's request in this tick; ``status``: newest status of the vehicle."""
        requested = self.person.operator
        if requested is Operator.EMERGENCY_STOP or status is None or not status.armed:
            return requested
        if self.leaves:
            return Operator.LAND
        if self._theirs:
            return Operator.NONE
        return Operator.TIME_OVER if self._over(now_s) and requested is Operator.NONE else requested

    def ended(self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float) -> Ended | None:
        """Return how the flight ended with the outputs of this tick; None if it has not ended."""
        if out.finished:
            suffix = f"; {self._duration_s:g} s are over" if self._over(now_s) else ""
            return Ended(out.phase, memory.reason + suffix, 0 if out.phase is Phase.LANDED else 1)
        armed = status is not None and status.armed
        self.arms = self.arms or memory.phase not in (Phase.WAIT, Phase.ABORT)
        self._theirs = armed and memory.phase is Phase.WAIT and not memory.was_external
        if self.person.stop or (self._theirs and self.person.operator is Operator.ABORT):
            return Ended(out.phase, "ended by the operator", 1)
        if self._over(now_s) and not flies(memory, status):
            return Ended(out.phase, f"{self._duration_s:g} s are over", 1)
        return None

    def _over(self, now_s: float) -> bool:
        return self._duration_s is not None and now_s >= self._duration_s


def flies(memory: Memory, status: VehicleStatus | None) -> bool:
    """Whether the vehicle is in the air, by its newest status, and only this process controls it."""
    if status is None or not status.armed or memory.abort_way is AbortWay.HANDS_OFF:
        return False
    if memory.phase is Phase.LANDED:  # the motors are off, and this process has not armed the vehicle again
        return False
    return memory.phase is not Phase.WAIT or memory.was_external


def fly(ticks: Runner, vehicle: LinkedVehicle, leaving: Leaving, failed: Callable[[str], None]) -> Ended:
    """Fly until the flight is over or an error occurs, then release the vehicle.

    Autopilots differ when set-points stop: PX4 lands, ArduPilot hovers. A process that ends in flight
    therefore requests the autopilot's landing until a heartbeat confirms it, for a bounded time: through the
    controller as long as ticks can run, or directly after an exception.

    ``leaving``: decides when the flight is over; ``failed``: receives the text of an exception.
    """
    ended: Ended | None = None
    works = True
    try:
        while ended is None:
            ended = ticks.tick()
    except ClockStoppedError as error:
        ended, works = Ended(ticks.memory.phase, str(error), 1), False
    except BaseException as error:  # any exception: a library may even raise SystemExit
        reason = failed_in(ticks.filter_name, error) or f"internal error: {error!r}"
        ended, works = Ended(ticks.memory.phase, reason, 1), False
        with contextlib.suppress(Exception):
            failed(f"{ended.reason}\n{traceback.format_exc()}")
    return _leave(ended, ticks, vehicle, leaving, works=works)


def _leave(ended: Ended, ticks: Runner, vehicle: LinkedVehicle, leaving: Leaving, *, works: bool) -> Ended:
    """Request the landing until the heartbeat confirms it; the reason states whether it did."""
    memory, began_s, leaving.leaves = ticks.memory, time.monotonic(), True
    arms = leaving.arms and not memory.was_armed  # arming may follow after this process has ended
    works = works and not arms
    while True:
        status, waited_s = vehicle.read().status, time.monotonic() - began_s
        lands, in_air = status is not None and status.mode is Mode.LAND, flies(memory, status)
        off = memory.abort_way is AbortWay.MOTORS_OFF  # whether an emergency stop was requested
        if lands or waited_s >= LAND_SHOWN_MAX_S or not (in_air or (arms and status is not None)):
            break
        if works:
            try:
                ticks.tick()
            except BaseException:  # after an exception the loop continues without the controller
                works = False
        else:
            with contextlib.suppress(Exception):
                vehicle.ask(Request.MOTORS_OFF if off else Request.LAND, ticks.now_s + waited_s)
            time.sleep(_PERIOD_S)
    if not in_air:
        return ended
    shown = "the vehicle lands"
    if not lands:
        wanted = "its motors are off" if off else "it lands"
        shown = f"the vehicle did not report in {LAND_SHOWN_MAX_S:g} s that {wanted}"
    return ended._replace(phase=memory.phase, reason=f"{ended.reason}; {shown}")
