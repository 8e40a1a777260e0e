"""How the onboard process leaves a vehicle: never in the air without having asked for its landing.

Autopilots differ in what they do when set-points stop: PX4 lands, ArduPilot hovers. So a process that is told
to end asks for the vehicle's own landing first, and one whose time is over aborts as a person would have it.
"""

from __future__ import annotations

import signal
from dataclasses import dataclass
from types import FrameType
from typing import NamedTuple, Protocol

from flightstack.common.hangup import on_hangup
from flightstack.core.controller import Outputs
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Mode, Operator, Phase, VehicleStatus

LAND_SHOWN_MAX_S = 1.0  # s in which the landing is asked for until a heartbeat, sent at 1 Hz, shows it


class Ended(NamedTuple):
    """How the process ended."""

    phase: Phase
    reason: str
    exit_code: int


class Person(Protocol):
    """What a person asks of the process."""

    @property
    def operator(self) -> Operator:
        """Asked of the controller."""

    @property
    def stop(self) -> bool:
        """Whether the process is to end at once."""


class Signals:
    r"""Ctrl-C, or a terminal that closes, asks for an abort; Ctrl-\ for the motors to stop at once.

    A second Ctrl-C or SIGTERM ends the process once the vehicle has been told to land itself.
    """

    def __init__(self) -> None:
        self.operator = Operator.NONE
        self.stop = False
        signal.signal(signal.SIGINT, self._interrupt)
        signal.signal(signal.SIGTERM, self._terminate)
        signal.signal(signal.SIGQUIT, self._emergency)
        on_hangup(self._abort)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.stop = self.operator is not Operator.NONE
        self._abort(number, frame)

    def _abort(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.operator = max(self.operator, Operator.ABORT)

    def _emergency(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.operator = Operator.EMERGENCY_STOP

    def _terminate(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.stop = True


@dataclass(frozen=True)
class _Nobody:
    operator: Operator = Operator.NONE
    stop: bool = False


class Leaving:
    """One flight's end; ``operator`` before each step, ``ended`` after it.

    Args:
        duration_s: on the stack's clock, after which the flight is aborted; None: no such limit.
        person: who may abort or end it; None: nobody.
    """

    def __init__(self, duration_s: float | None, person: Person | None = None) -> None:
        self._duration_s = duration_s
        self.person = person if person is not None else _Nobody()
        self._landing_since_s: float | None = None  # when the landing was asked for first

    def operator(self, status: VehicleStatus | None, now_s: float) -> Operator:
        """Return what the controller is to be told in this tick.

        Args:
            status: newest status of the vehicle.
            now_s: the stack's clock.
        """
        asked = self.person.operator
        if asked is Operator.EMERGENCY_STOP or status is None or not status.armed:
            return asked
        if self.person.stop:
            if self._landing_since_s is None:
                self._landing_since_s = now_s
            return Operator.LAND
        return Operator.ABORT if self._over(now_s) else asked

    def ended(self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float) -> Ended | None:
        """Return how the flight ended; None if it has not ended.

        Args:
            out: of this tick.
            memory: of the controller.
            status: newest status of the vehicle.
            now_s: the stack's clock.
        """
        if out.finished:
            told = f"; {self._duration_s:g} s are over" if self._over(now_s) else ""
            return Ended(out.phase, memory.reason + told, 0 if out.phase is Phase.LANDED else 1)
        flying = status is not None and status.armed and memory.abort_way is not AbortWay.HANDS_OFF
        if self.person.stop and not (flying and self._asks(status, now_s)):
            return Ended(out.phase, self._how(status, flying=flying), 1)
        if self._over(now_s) and not flying:
            return Ended(out.phase, f"{self._duration_s:g} s are over", 1)
        return None

    def _over(self, now_s: float) -> bool:
        return self._duration_s is not None and now_s >= self._duration_s

    def _asks(self, status: VehicleStatus | None, now_s: float) -> bool:
        """Whether the landing is still to be asked for."""
        shown = status is not None and status.mode is Mode.LAND
        since_s = self._landing_since_s
        return not shown and (since_s is None or now_s - since_s < LAND_SHOWN_MAX_S)

    def _how(self, status: VehicleStatus | None, *, flying: bool) -> str:
        if not flying or status is None:
            return "ended by the operator"
        if status.mode is Mode.LAND:
            return "ended by the operator; the vehicle lands"
        return f"ended by the operator; the vehicle did not show in {LAND_SHOWN_MAX_S:g} s that it lands"
