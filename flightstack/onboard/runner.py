"""Sequence of one tick: wait, take the inputs, step the controller, send the outputs, write the log.

Real time, lockstep and a landing in one process all use this sequence. They differ in five parts: the clock,
the vehicle, the source of target samples, the end of the flight, and the sink of the rows.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.codec.messages import Message
from bridge.ros2.cdr import OdometryError
from bridge.target.odometry import RawSample, SampleSource, sample_of
from flightstack.common.pacing import RealTimePacer, Tick
from flightstack.core.controller import Controller, Outputs
from flightstack.core.memory import Memory
from flightstack.core.types import (
    Inputs,
    MemberStatus,
    Operator,
    OwnState,
    Phase,
    Power,
    Request,
    TargetSample,
    VehicleStatus,
)


class Arrived(NamedTuple):
    """Target data that arrived since the last tick."""

    samples: tuple[TargetSample, ...] = ()  # samples for the controller
    problems: Sequence[str] = ()  # errors of messages that could not be decoded
    messages: Sequence[RawSample] = ()  # raw messages for the log; empty if they are not recorded


NOTHING = Arrived()
STALL_MAX_S = 0.05  # largest delay of a tick whose samples are used, s: checks.target_age_max_s / 5


class Taken(NamedTuple):
    """Arguments of ``Controller.step``, and the raw messages of their samples."""

    inputs: Inputs
    command_failed: bool
    arrived: Arrived = NOTHING


class VehicleInputs(NamedTuple):
    """Newest state, status and power of the vehicle, and whether it finally refused a requested mode."""

    own: OwnState | None
    status: VehicleStatus | None
    command_failed: bool
    power: Power | None = None


class Ended(NamedTuple):
    """Result of a flight: last phase, its reason, and the exit status of the process."""

    phase: Phase
    reason: str
    exit_code: int


Statuses = Callable[[], tuple[MemberStatus, ...]]  # source of the statuses of other vehicles


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
        """Report the start of the landing; a simulated robot may drive from this tick."""


class Ending(Protocol):
    """The operator's request in a tick, and how the flight ended (``leaving.Leaving``)."""

    def operator(self, status: VehicleStatus | None, now_s: float) -> Operator: ...

    def ended(
        self, out: Outputs, memory: Memory, status: VehicleStatus | None, now_s: float
    ) -> Ended | None: ...


class Sink(Protocol):
    """Writer of ticks; ``exec_s`` is the wall time until the outputs were sent to the vehicle."""

    def write(self, tick: Tick, taken: Taken, out: Outputs, exec_s: float) -> None: ...


class Runner:
    """Runs the ticks of a flight."""

    def __init__(self, controller: Controller, wires: Wires, ending: Ending, sink: Sink) -> None:
        self._controller, self._wires, self._ending, self._sink = controller, wires, ending, sink
        self._landing = False
        self.now_s = 0.0  # stack clock at the newest tick

    @property
    def memory(self) -> Memory:
        """State of the controller's mission and commands."""
        return self._controller.memory

    @property
    def filter_name(self) -> str:
        """Name of the filter that flies."""
        return self._controller.config.filter

    def tick(self) -> Ended | None:
        """Run one tick; the outputs are sent to the vehicle before they are logged."""
        controller, wires = self._controller, self._wires
        tick = wires.wait()
        began_s = time.perf_counter()
        self.now_s = now_s = tick.now_s
        arrived = wires.samples(now_s)
        own, status, command_failed, power = wires.read()
        operator = self._ending.operator(status, now_s)
        inputs = Inputs(own, status, arrived.samples, operator, power, wires.statuses())
        out = controller.step(inputs, now_s, command_failed=command_failed)
        wires.answer(out, now_s)
        exec_s = time.perf_counter() - began_s
        memory = controller.memory
        if not self._landing and memory.started_s <= now_s:
            self._landing = True
            wires.landing_began(tick.number)
        self._sink.write(tick, Taken(inputs, command_failed, arrived), out, exec_s)
        return self._ending.ended(out, memory, status, now_s)


class LinkedVehicle:
    """Vehicle with a MAVLink link; the clock reads the link."""

    def __init__(self, link: VehicleLink, *, lockstep: bool) -> None:
        self.link, self._lockstep = link, lockstep  # MAVLink link to the vehicle
        self._reply: Message = None

    @property
    def reply(self) -> bytes:
        """Frame of the last answer in lockstep, for a vehicle that repeats its request."""
        return bytes(self._reply.get_msgbuf() or b"") if self._reply is not None else b""

    def read(self) -> VehicleInputs:
        """Return the newest data that the link has decoded."""
        link = self.link
        state, status = link.state, link.state.status
        if status is not None and status.ready_to_arm and link.senders.suspects:
            status = replace(status, ready_to_arm=False)  # the status may be that of a second vehicle
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
    """Wires in real time, with a clock that has deadlines; the robot is not informed about the landing."""

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

        Samples of a tick in which the process stalled are dropped: they may have arrived after the tick
        started, would reduce the minimum delay too much, and later samples would then count as too late.
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

    def __init__(self) -> None:
        self._count, self._due = 0, 1

    def told(self, problems: Iterable[str]) -> list[str]:
        """Count the problems, and return those that must be reported now."""
        found = []
        for text in problems:
            if not text.startswith(REFUSED):
                found.append(text)
                continue
            self._count += 1
            if self._count == self._due:
                self._due *= 2
                found.append(text if self._count == 1 else f"{text} ({self._count} refused so far)")
        return found


def decoded(messages: Sequence[RawSample], now_s: float) -> Arrived:
    """Decode messages that arrive now; return their samples, and why other messages contain none."""
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
