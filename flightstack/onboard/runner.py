"""Sequence of one tick: wait, take the inputs, step the controller, send the outputs, write the log.

Real time, lockstep and a landing in one process all use this sequence. They differ in five parts: the clock,
the vehicle, the source of target samples, the end of the flight, and the sink of the rows.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

from bridge.mavlink.client.companion import Origin
from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.codec.messages import Message
from bridge.mavlink.endpoint import Endpoint
from bridge.mavlink.profiles import Profile
from bridge.ros2.cdr import OdometryError
from bridge.target.odometry import RawSample, SampleSource, sample_of
from flightstack.common.pacing import RealTimePacer, Tick
from flightstack.core.controller import Controller, Outputs
from flightstack.core.memory import AbortWay
from flightstack.core.parameters.filters import failed_in
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import (
    Inputs,
    MemberStatus,
    Mode,
    OwnState,
    Power,
    Request,
    TargetSample,
    VehicleStatus,
)
from flightstack.onboard.leaving import LAND_SHOWN_MAX_S, Ended, Leaving, flies


class Arrived(NamedTuple):
    """Target data that arrived since the last tick."""

    samples: tuple[TargetSample, ...] = ()  # samples for the controller
    problems: Sequence[str] = ()  # errors of messages that could not be decoded
    messages: Sequence[RawSample] = ()  # raw messages for the log; empty if they are not recorded


NOTHING = Arrived()
_PERIOD_S = 0.02  # wall time between two landing requests after the last tick, s
STALL_MAX_S = 0.05  # maximum delay of a tick whose samples are used, s: 1/5 of the default target_age_max_s


class Taken(NamedTuple):
    """Arguments of ``Controller.step``, and the raw messages of their samples."""

    inputs: Inputs
    command_failed: bool
    arrived: Arrived = NOTHING


class VehicleInputs(NamedTuple):
    """Newest state, status and power of the vehicle, and whether the current request has failed."""

    own: OwnState | None
    status: VehicleStatus | None
    command_failed: bool
    power: Power | None = None


Statuses = Callable[[], tuple[MemberStatus, ...]]  # function that returns the statuses of other vehicles


class ClockStoppedError(RuntimeError):
    """No further tick arrives; the text gives the reason."""


class Wires(Protocol):
    """Everything that a tick exchanges with its clock, the vehicle, the target and other vehicles."""

    def wait(self) -> Tick:
        """Wait for the next tick, and read the vehicle's messages until then."""

    def samples(self, now_s: float) -> Arrived:
        """Return the target's samples since the last call; ``now_s`` is their arrival time."""

    def read(self) -> VehicleInputs: ...

    def statuses(self) -> tuple[MemberStatus, ...]:
        """Return the statuses of other vehicles since the last tick."""

    def answer(self, out: Outputs, now_s: float) -> None:
        """Send the outputs of the tick to the vehicle."""

    def landing_began(self, tick: int) -> None:
        """Report the start of the landing; a simulated robot starts to drive then."""

    def ask(self, request: Request, now_s: float) -> None:
        """Request a mode from the vehicle without the controller."""


class Runner:
    """Runner of a flight's ticks; ``write`` logs a tick and the wall time until its outputs were sent, s."""

    def __init__(
        self, controller: Controller, wires: Wires, leaving: Leaving,
        write: Callable[[Tick, Taken, Outputs, float], None],
    ) -> None:  # fmt: skip
        self._controller, self._wires, self._leaving, self._write = controller, wires, leaving, write
        self._landing = False
        self._now_s = 0.0  # time of the newest tick on the stack's clock, s

    def fly(self, failed: Callable[[str], None]) -> Ended:
        """Fly until the flight is over or an error occurs, then release the vehicle.

        Autopilots differ when set-points stop: PX4 lands, ArduPilot hovers. A process that ends in flight
        therefore requests the autopilot's landing until a heartbeat confirms it, for a bounded time. The
        controller makes the request as long as ticks can run. After an exception the process requests the
        landing directly, and ``failed`` receives the text of the exception.
        """
        controller, ended, works = self._controller, None, True
        try:
            while ended is None:
                ended = self.tick()
        except ClockStoppedError as error:
            ended, works = Ended(controller.memory.phase, str(error), 1), False
        except BaseException as error:  # any exception: a library can even raise SystemExit
            reason = failed_in(controller.config.filter, error) or f"internal error: {error!r}"
            ended, works = Ended(controller.memory.phase, reason, 1), False
            with contextlib.suppress(Exception):
                failed(f"{reason}\n{traceback.format_exc()}")
        return self._leave(ended, works=works)

    def _leave(self, ended: Ended, *, works: bool) -> Ended:
        """Request the landing until the heartbeat confirms it; the returned reason states the outcome."""
        memory, began_s, self._leaving.leaves = self._controller.memory, time.monotonic(), True
        arms = self._leaving.arms and not memory.was_armed  # the vehicle may arm after this process has ended
        works = works and not arms
        while True:
            status, waited_s = self._wires.read().status, time.monotonic() - began_s
            lands, in_air = status is not None and status.mode is Mode.LAND, flies(memory, status)
            off = memory.abort_way is AbortWay.MOTORS_OFF  # whether the operator requested an emergency stop
            if lands or waited_s >= LAND_SHOWN_MAX_S or not (in_air or (arms and status is not None)):
                break
            if works:
                try:
                    self.tick()
                except BaseException:  # after an exception the loop continues without the controller
                    works = False
            else:
                with contextlib.suppress(Exception):
                    self._wires.ask(Request.MOTORS_OFF if off else Request.LAND, self._now_s + waited_s)
                time.sleep(_PERIOD_S)
        if not in_air:
            return ended
        shown = "the vehicle lands"
        if not lands:
            wanted = "its motors are off" if off else "it lands"
            shown = f"the vehicle did not report in {LAND_SHOWN_MAX_S:g} s that {wanted}"
        return ended._replace(phase=memory.phase, reason=f"{ended.reason}; {shown}")

    def tick(self) -> Ended | None:
        """Run one tick; the outputs are sent to the vehicle before they are logged."""
        controller, wires = self._controller, self._wires
        tick = wires.wait()
        began_s = time.perf_counter()
        self._now_s = now_s = tick.now_s
        arrived = wires.samples(now_s)
        own, status, command_failed, power = wires.read()
        operator = self._leaving.operator(status, now_s)
        inputs = Inputs(own, status, arrived.samples, operator, power, wires.statuses())
        out = controller.step(inputs, now_s, command_failed=command_failed)
        wires.answer(out, now_s)
        exec_s = time.perf_counter() - began_s
        memory = controller.memory
        if not self._landing and memory.started_s <= now_s:
            self._landing = True
            wires.landing_began(tick.number)
        self._write(tick, Taken(inputs, command_failed, arrived), out, exec_s)
        return self._leaving.ended(out, memory, status, now_s)


def open_link(
    config: FlightConfig, endpoint: Endpoint, system_id: int, profile: Profile | None, *, lockstep: bool,
    every: int = 1,
) -> VehicleLink:  # fmt: skip
    """Return the link of a flight with this configuration; ``every``: ticks between set-points."""
    origin = config.vehicle.origin_wgs84
    return VehicleLink(
        endpoint,
        takeoff_height_m=config.takeoff.height_m,
        rate_hz=config.loop.rate_hz,
        system_id=system_id,
        defer_timesync=lockstep,
        profile=profile,
        origin=Origin(*origin) if origin is not None else None,
        every=every,
        power=config.reserve is not None,
    )


class LinkedVehicle:
    """Vehicle with a MAVLink link; the method ``wait`` of a subclass reads the link."""

    def __init__(self, link: VehicleLink, *, lockstep: bool) -> None:
        self.link, self._lockstep = link, lockstep
        self._reply: Message = None

    @property
    def reply(self) -> bytes:
        """Frame of the last reply in lockstep, for a vehicle that repeats its request."""
        return bytes(self._reply.get_msgbuf() or b"") if self._reply is not None else b""

    def read(self) -> VehicleInputs:
        """Return the newest data that the link has decoded."""
        link = self.link
        state, status = link.state, link.state.status
        if status is not None and status.ready_to_arm and link.senders.suspects:
            status = replace(status, ready_to_arm=False)  # the status may come from a second vehicle
        return VehicleInputs(state.own, status, link.failed is not None, state.power)

    def ask(self, request: Request, now_s: float) -> None:
        """Read the link, then request a mode from the vehicle without the controller."""
        self.link.poll(now_s)
        self.link.command(request, now_s)
        self.link.flush()

    def answer(self, out: Outputs, now_s: float) -> None:
        """Send set-point and commands in one datagram; in lockstep also the reply that ends the tick."""
        link = self.link
        if out.setpoint is not None:
            link.send_setpoint(out.setpoint, now_s)
        link.command(out.request, now_s)
        if not self._lockstep:
            link.flush()
            return
        self._reply = reply = link.timesync_reply(round(now_s * 1e9))
        link.flush([reply])


class LiveWires(LinkedVehicle):
    """Wires in real time, whose ticks have deadlines; the robot receives no message about the landing."""

    def __init__(
        self, link: VehicleLink, pacer: RealTimePacer, source: SampleSource, statuses: Statuses
    ) -> None:
        super().__init__(link, lockstep=False)
        self._pacer, self._source, self.statuses = pacer, source, statuses

    def wait(self) -> Tick:
        """Sleep until the next deadline, then read the vehicle's messages."""
        tick = self._pacer.wait()
        self.link.poll(tick.now_s)
        return tick

    def samples(self, now_s: float) -> Arrived:
        """Return the samples that have arrived since the last call.

        Samples of a tick in which the process stalled are dropped. Samples that arrived after the tick
        started would reduce the minimum delay too much, and later samples would count as too late.
        """
        messages = self._source.poll()
        stall_s = self._pacer.now_s() - now_s
        if messages and stall_s > STALL_MAX_S:
            text = f"target samples not used: the process stalled for {stall_s:.2f} s before it had read them"
            return Arrived((), [text], messages)
        return decoded(messages, now_s)

    def landing_began(self, tick: int) -> None:
        pass


REFUSED = "target sample refused: "


class Refusals:
    """Counter of rejected samples; it reports each doubling of the count, to keep the log short."""

    count = 0

    def told(self, problems: Iterable[str]) -> list[str]:
        """Count the problems, and return those that must be reported now."""
        found = []
        for text in problems:
            refused = text.startswith(REFUSED)
            self.count += refused
            if not refused or self.count == 1:
                found.append(text)
            elif self.count & (self.count - 1) == 0:  # the count is a power of two
                found.append(f"{text} ({self.count} refused so far)")
        return found


def decoded(messages: Sequence[RawSample], now_s: float) -> Arrived:
    """Decode messages that arrive now; return samples, and the errors of messages without a sample."""
    if not messages:
        return NOTHING
    samples: list[TargetSample] = []
    problems: list[str] = []
    for message in messages:
        try:
            samples.append(sample_of(message, now_s))
        except OdometryError as error:
            problems.append(f"{REFUSED}{error}")
    return Arrived(tuple(samples), problems, messages)
