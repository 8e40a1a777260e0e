"""The one way out of a flight: whatever ends it, the vehicle is told to land before the process ends.

Autopilots differ in what they do when set-points stop: PX4 lands, ArduPilot hovers. So a process that ends in
flight asks for the vehicle's own landing until a heartbeat shows it, for a bounded time. The controller asks
for it as long as ticks can be run; after an exception the vehicle is asked directly.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable
from typing import Protocol

from flightstack.core.memory import AbortWay, Memory
from flightstack.core.types import Mode, Request
from flightstack.onboard.leaving import LAND_SHOWN_MAX_S, Ended, Leaving, flies
from flightstack.onboard.runner import ClockStoppedError, VehicleInputs

_PERIOD_S = 0.02  # s between two looks without ticks


class Ticks(Protocol):
    """What runs the ticks of a flight (``flightstack.onboard.runner.Runner``)."""

    now_s: float  # stack clock at the newest tick

    @property
    def memory(self) -> Memory:
        """Of the controller."""

    def tick(self) -> Ended | None:
        """Run one tick; how the flight ended, None if it has not."""


class Left(Protocol):
    """The vehicle that is left (``flightstack.onboard.runner.LinkedVehicle``)."""

    def read(self) -> VehicleInputs:
        """Return what is known of it."""

    def ask(self, request: Request, now_s: float) -> None:
        """Hear it and ask for a mode, without the controller."""


def fly(ticks: Ticks, vehicle: Left, leaving: Leaving, failed: Callable[[str], None]) -> Ended:
    """Fly until the flight is over or something breaks, then leave the vehicle.

    ``leaving``: decides when the flight is over; ``failed``: takes the text of an exception.
    """
    ended: Ended | None = None
    works = True
    try:
        while ended is None:
            ended = ticks.tick()
    except ClockStoppedError as error:
        ended, works = Ended(ticks.memory.phase, str(error), 1), False
    except BaseException as error:  # of any kind: a library may even raise SystemExit
        ended, works = Ended(ticks.memory.phase, f"internal error: {error!r}", 1), False
        with contextlib.suppress(Exception):
            failed(f"{ended.reason}\n{traceback.format_exc()}")
    return _leave(ended, ticks, vehicle, leaving, works=works)


def _leave(ended: Ended, ticks: Ticks, vehicle: Left, leaving: Leaving, *, works: bool) -> Ended:
    """Ask for the landing until it shows; the reason then says whether it does."""
    memory, began_s, leaving.leaves = ticks.memory, time.monotonic(), True
    arms = leaving.arms and not memory.was_armed  # perhaps only when this process has ended
    works = works and not arms
    status = vehicle.read().status
    while flies(memory, status) or (arms and status is not None and status.mode is not Mode.LAND):
        lands = status is not None and status.mode is Mode.LAND
        waited_s = time.monotonic() - began_s
        if lands or waited_s >= LAND_SHOWN_MAX_S:
            break
        if works:
            try:
                ticks.tick()
            except BaseException:  # as above; then without it
                works = False
        else:
            with contextlib.suppress(Exception):
                vehicle.ask(Request.MOTORS_OFF if _off(memory) else Request.LAND, ticks.now_s + waited_s)
            time.sleep(_PERIOD_S)
        status = vehicle.read().status
    if not flies(memory, status):
        return ended
    shown = "the vehicle lands"
    if status is None or status.mode is not Mode.LAND:
        wanted = "its motors are off" if _off(memory) else "it lands"
        shown = f"the vehicle did not show in {LAND_SHOWN_MAX_S:g} s that {wanted}"
    return ended._replace(phase=memory.phase, reason=f"{ended.reason}; {shown}")


def _off(memory: Memory) -> bool:
    """Whether an emergency stop was asked for."""
    return memory.abort_way is AbortWay.MOTORS_OFF
