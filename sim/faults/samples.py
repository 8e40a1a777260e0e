"""Faults of a stream of samples: motion capture, own state, target odometry."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from flightstack.core.types import Vec3
from sim.faults.schedule import Running
from sim.plant.sensors import NEVER_NS, NS
from sim.scenarios.fault_table import Kind

S = TypeVar("S")

HELD_MAX = 8192  # samples; 5 s at 500 Hz are 2500


class Shape(NamedTuple, Generic[S]):
    """What faults do to a kind of sample."""

    move: Callable[[S, Vec3, float], S]  # by an offset (ENU, m) and a turn (rad)
    freeze: Callable[[S, S], S]  # the first sample, with the time stamp of the second


def paused(running: Running, now_ns: int) -> bool:
    """Whether an intermittent fault pauses now; it begins with a pause."""
    since_s = (now_ns - running.start_ns) / NS
    return since_s % running.fault.period < running.fault.amount


def nth(running: Running, count: int) -> bool:
    """Whether a slow fault lets number ``count`` (from 0) pass: the last of each group."""
    return count % round(running.fault.amount) == round(running.fault.amount) - 1


class SampleFaults(Generic[S]):
    """Carries out the faults of one stream, one after the other in the order of their beginning.

    Attributes:
        release_ns: when a held sample is due.
    """

    def __init__(self, shape: Shape[S]) -> None:
        self._shape = shape
        self._running: list[_One[S]] = []
        self._held: deque[tuple[int, S]] = deque()
        self.release_ns = NEVER_NS

    @property
    def running(self) -> bool:
        """Whether any fault is on."""
        return bool(self._running)

    @property
    def active(self) -> bool:
        """Whether samples have to go through ``deliver``."""
        return bool(self._running or self._held)

    def begin(self, running: Running) -> None:
        """A fault is on."""
        self._running.append(_One(running, self._shape))

    def end(self, running: Running, now_ns: int) -> None:
        """It is over; what it held back is due now."""
        self._running = [one for one in self._running if one.running is not running]
        if running.fault.kind is Kind.DELAYED:
            self._held = deque((min(due_ns, now_ns), sample) for due_ns, sample in self._held)
            self.release_ns = self._held[0][0] if self._held else NEVER_NS

    def deliver(self, now_ns: int, samples: list[S]) -> list[S]:
        """What arrives now, in order, when ``samples`` would have arrived.

        Args:
            now_ns: simulated time.
            samples: those of now; may be empty.
        """
        for sample in samples:
            kept = self._through(sample, now_ns)
            if kept is not None and len(self._held) < HELD_MAX:
                delay_ns = sum(one.delay_ns for one in self._running)
                due_ns = max(now_ns + delay_ns, self._held[-1][0] if self._held else 0)
                self._held.append((due_ns, kept))
        out = []
        while self._held and self._held[0][0] <= now_ns:
            out.append(self._held.popleft()[1])
        self.release_ns = self._held[0][0] if self._held else NEVER_NS
        return out

    def _through(self, sample: S, now_ns: int) -> S | None:
        for one in self._running:
            kept = one.apply(sample, now_ns)
            if kept is None:
                return None
            sample = kept
        return sample


class _One(Generic[S]):
    """One running fault of a stream."""

    def __init__(self, running: Running, shape: Shape[S]) -> None:
        self.running = running
        fault = running.fault
        self.delay_ns = round(fault.amount * NS) if fault.kind is Kind.DELAYED else 0
        self._shape = shape
        self._first: S | None = None
        self._count = 0
        angles = running.rng.uniform(0.0, math.pi, 2).tolist() if fault.kind is Kind.DRIFT else (0.0, 0.0)
        sine = math.sin(angles[1])
        self._direction = (
            math.cos(2.0 * angles[0]) * sine,
            math.sin(2.0 * angles[0]) * sine,
            math.cos(angles[1]),
        )
        self.apply = {
            Kind.OFF: self._off,
            Kind.STUCK: self._stuck,
            Kind.WRONG: self._wrong,
            Kind.SLOW: self._slow,
            Kind.DELAYED: self._pass,
            Kind.INTERMITTENT: self._intermittent,
            Kind.GARBAGE: self._garbage,
            Kind.DRIFT: self._drift,
        }[fault.kind]

    def _off(self, sample: S, now_ns: int) -> S | None:
        del sample, now_ns
        return None

    def _pass(self, sample: S, now_ns: int) -> S | None:
        del now_ns
        return sample

    def _stuck(self, sample: S, now_ns: int) -> S | None:
        del now_ns
        if self._first is None:
            self._first = sample
        return self._shape.freeze(self._first, sample)

    def _wrong(self, sample: S, now_ns: int) -> S | None:
        del now_ns
        return self._shape.move(sample, self.running.fault.offset, self.running.fault.yaw_rad or 0.0)

    def _slow(self, sample: S, now_ns: int) -> S | None:
        del now_ns
        self._count += 1
        return sample if nth(self.running, self._count - 1) else None

    def _intermittent(self, sample: S, now_ns: int) -> S | None:
        return None if paused(self.running, now_ns) else sample

    def _garbage(self, sample: S, now_ns: int) -> S | None:
        del now_ns
        half = self.running.fault.amount
        x, y, z, turn = self.running.rng.uniform(-1.0, 1.0, 4).tolist()
        return self._shape.move(sample, (half * x, half * y, half * z), math.pi * turn)

    def _drift(self, sample: S, now_ns: int) -> S | None:
        length = self.running.fault.amount * (now_ns - self.running.start_ns) / NS
        x, y, z = self._direction
        return self._shape.move(sample, (length * x, length * y, length * z), 0.0)
