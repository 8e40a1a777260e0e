"""Faults of sample streams (motion capture, vehicle state, target odometry), and losses of a stream."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from bridge.frames import Quat
from flightstack.core.types import Vec3
from sim.faults.schedule import Component, Running
from sim.firmware.estimator import INNOVATION_AGE_MAX_S
from sim.plant.sensors import NEVER_NS, NS
from sim.plant.states import Estimate
from sim.scenarios.fault_spec import Kind

S = TypeVar("S")

HELD_MAX = 8192  # maximum number of delayed samples; 5 s at 500 Hz are 2500
ESTIMATE_PERIOD_NS = NS // 100  # period of a Crazyflie's log stream of the state estimate, ns


def _in_bursts(running: Running, now_ns: int) -> bool:
    burst, change_ns = running.memory or (True, running.start_ns)  # a burst fault starts without loss
    while now_ns >= change_ns:
        burst = not burst
        mean_s = running.fault.amount if burst else running.fault.period
        change_ns += max(1, round(running.rng.exponential(mean_s) * NS))
    running.memory = burst, change_ns
    return bool(burst)


def _all_but_each_nth(running: Running, _: int) -> bool:
    running.memory = (running.memory or 0) + 1
    return bool(running.memory % round(running.fault.amount))


# function from fault and time (ns) to whether a sample or message is lost, by kind of loss
LOST: Mapping[Kind, Callable[[Running, int], bool]] = {
    Kind.OFF: lambda _, __: True,
    Kind.LOSS: lambda running, _: running.happens(),
    Kind.BURST_LOSS: _in_bursts,
    Kind.SLOW: _all_but_each_nth,
    Kind.INTERMITTENT: Running.paused,
}


class Shape(NamedTuple, Generic[S]):
    """Operations that the faults apply to one kind of sample."""

    move: Callable[[S, Vec3, float], S]  # moves a sample by offset (ENU, m) and yaw (rad)
    freeze: Callable[[S, S], S]  # returns the first sample with the time stamp of the second


def _stuck(running: Running, shape: Shape[S], sample: S, _: int) -> S:
    if running.memory is None:
        running.memory = sample
    return shape.freeze(running.memory, sample)


def _wrong(running: Running, shape: Shape[S], sample: S, _: int) -> S:
    return shape.move(sample, running.fault.offset, running.fault.yaw_rad or 0.0)


def _garbage(running: Running, shape: Shape[S], sample: S, _: int) -> S:
    half = running.fault.amount
    x, y, z, turn = running.rng.uniform(-1.0, 1.0, 4).tolist()
    return shape.move(sample, (half * x, half * y, half * z), math.pi * turn)


def _drift(running: Running, shape: Shape[S], sample: S, now_ns: int) -> S:
    if running.memory is None:
        running.memory = running.rng.uniform(0.0, math.pi, 2).tolist()
    first, second = running.memory
    sine, length = math.sin(second), running.fault.amount * (now_ns - running.start_ns) / NS
    x, y, z = math.cos(2.0 * first) * sine, math.sin(2.0 * first) * sine, math.cos(second)
    return shape.move(sample, (length * x, length * y, length * z), 0.0)


# function from fault, operations, sample and time (ns) to the changed sample
CHANGES: Mapping[Kind, Callable[[Running, Shape[Any], Any, int], Any]] = {
    Kind.STUCK: _stuck,
    Kind.WRONG: _wrong,
    Kind.GARBAGE: _garbage,
    Kind.DRIFT: _drift,
}


class SampleFaults(Component, Generic[S]):
    """Applies the faults of one stream in the order of their start."""

    def __init__(self, shape: Shape[S]) -> None:
        super().__init__()
        self._shape = shape
        self._held: deque[tuple[int, S]] = deque()

    @property
    def release_ns(self) -> int:
        """Time at which the next delayed sample is due, ns."""
        return self._held[0][0] if self._held else NEVER_NS

    @property
    def active(self) -> bool:
        """Whether samples need a call of ``deliver``."""
        return bool(self.running or self._held)

    def end(self, running: Running, now_ns: int) -> None:
        """End a fault; delayed samples are due now."""
        super().end(running, now_ns)
        if running.fault.kind is Kind.DELAYED:
            self._held = deque((min(due_ns, now_ns), sample) for due_ns, sample in self._held)

    def deliver(self, now_ns: int, samples: list[S]) -> list[S]:
        """Return the samples that arrive now, in order; without faults these are ``samples``."""
        delays_s = (one.fault.amount for one in self.running if one.fault.kind is Kind.DELAYED)
        due_ns = now_ns + sum(round(delay_s * NS) for delay_s in delays_s)
        for sample in samples:
            kept = self._through(sample, now_ns)
            if kept is not None and len(self._held) < HELD_MAX:
                self._held.append((max(due_ns, self._held[-1][0] if self._held else 0), kept))
        out = []
        while self.release_ns <= now_ns:
            out.append(self._held.popleft()[1])
        return out

    def _through(self, sample: S, now_ns: int) -> S | None:
        for one in self.running:
            kind = one.fault.kind
            if kind in LOST and LOST[kind](one, now_ns):
                return None
            if kind in CHANGES:
                sample = CHANGES[kind](one, self._shape, sample, now_ns)
        return sample


def turned(q: Quat, yaw_rad: float) -> Quat:
    """Return the attitude ``q`` after a turn of ``yaw_rad`` about the vertical."""
    c, s = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    w, x, y, z = q
    return (c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w)


def _move_estimate(estimate: Estimate, offset: Vec3, turn: float) -> Estimate:
    x, y, z = estimate.position_enu_m
    moved = (x + offset[0], y + offset[1], z + offset[2])
    return estimate._replace(position_enu_m=moved, quaternion=turned(estimate.quaternion, turn))


ESTIMATE: Shape[Estimate] = Shape(_move_estimate, lambda first, _: first)


class EstimateFaults(SampleFaults[Estimate]):
    """Faults of the state estimate between firmware and autopilot.

    On a Crazyflie the radio carries a log stream of the estimate. The firmware uses the correct estimate;
    autopilot and companion receive the faulty estimate. ``due_ns``: time of the next call of ``sample``.
    """

    def __init__(self) -> None:
        super().__init__(ESTIMATE)
        self._arrived_ns, self.due_ns = 0, NEVER_NS
        self._arrived: Estimate | None = None

    def begin(self, running: Running) -> None:
        super().begin(running)
        if self.due_ns == NEVER_NS:
            self.due_ns = running.start_ns

    def end(self, running: Running, now_ns: int) -> None:
        """End a fault; delayed samples are due now, or are dropped if no other fault is active."""
        super().end(running, now_ns)
        if not self.running:
            self._held.clear()
            self._arrived, self.due_ns = None, NEVER_NS

    def sample(self, now_ns: int, estimate: Estimate) -> None:
        """Apply the faults to a new estimate of the firmware."""
        self.due_ns += ESTIMATE_PERIOD_NS
        if self._arrived is None:
            self._arrived, self._arrived_ns = estimate, now_ns
        for arrived in self.deliver(now_ns, [estimate]):
            self._arrived, self._arrived_ns = arrived, now_ns

    def report(self, now_ns: int, estimate: Estimate) -> Estimate:
        """Return the estimate that the autopilot receives; invalid if older than ``INNOVATION_AGE_MAX_S``."""
        arrived = self._arrived
        if arrived is None:
            return estimate
        fresh = (now_ns - self._arrived_ns) / NS < INNOVATION_AGE_MAX_S
        return arrived if fresh else arrived._replace(valid=False)
