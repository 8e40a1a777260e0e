"""How the onboard process leaves a vehicle: never in the air without having asked for its landing.

Autopilots differ in what they do when set-points stop: PX4 lands, ArduPilot hovers. So a process that is told
to end asks for the vehicle's own landing first, and one whose time is over aborts as a person would have it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from flightstack.core.controller import Outputs
from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Mode, Operator, Phase, VehicleStatus

LAND_SHOWN_MAX_S = 1.0  # s in which the landing is asked for until a heartbeat, sent at 1 Hz, shows it


class Ended(NamedTuple):
    """How the process ended."""

    phase: Phase
    reason: str
    exit_code: int


class Leaving:
    """One flight's end; ``operator`` before each step, ``ended`` after it.

    Args:
        duration_s: on the stack's clock, after which the flight is aborted; None: no such limit.
    """

    def __init__(self, duration_s: float | None) -> None:
        self._duration_s = duration_s
        self._landing_since_s: float | None = None  # when the landing was asked for first

    def operator(
        self, asked: Operator, status: VehicleStatus | None, now_s: float, *, stop: bool = False
    ) -> Operator:
        """What the controller is to be told in this tick.

        Args:
            asked: by a person.
            status: newest status of the vehicle.
            now_s: the stack's clock.
            stop: the process is to end at once.
        """
        if asked is Operator.EMERGENCY_STOP or status is None or not status.armed:
            return asked
        if stop:
            if self._landing_since_s is None:
                self._landing_since_s = now_s
            return Operator.LAND
        return Operator.ABORT if self._over(now_s) else asked

    def ended(
        self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float, *, stop: bool = False
    ) -> Ended | None:
        """How the flight ended; None while it goes on.

        Args:
            out: of this tick.
            memory: of the controller.
            status: newest status of the vehicle.
            now_s: the stack's clock.
            stop: the process is to end at once.
        """
        if out.finished:
            told = f"; {self._duration_s:g} s are over" if self._over(now_s) else ""
            return Ended(out.phase, memory.reason + told, 0 if out.phase is Phase.LANDED else 1)
        flying = status is not None and status.armed and memory.abort_way is not AbortWay.HANDS_OFF
        if stop and not (flying and self._asks(status, now_s)):
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


class Patience:
    """Wall time for which a process in lockstep that is to end still waits for the others' ticks.

    Args:
        stop: whether it is to end.
    """

    def __init__(self, stop: Callable[[], bool]) -> None:
        self._stop = stop
        self._since_s: float | None = None

    def over(self) -> bool:
        """Whether it waits no longer."""
        if not self._stop():
            return False
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s >= LAND_SHOWN_MAX_S
