"""Faults of messages on their way: which come, when, and how often."""

from __future__ import annotations

from collections.abc import Callable

from sim.faults.samples import nth, paused
from sim.faults.schedule import Running
from sim.plant.sensors import NS
from sim.scenarios.fault_table import Kind

HELD_BACK_NS = 30_000_000  # of a reordered message: three ticks at 100 Hz

Due = list[int]  # when a message arrives, ns; none: never, two: twice


class Delivery:
    """One running fault that drops, delays or doubles messages."""

    def __init__(self, running: Running) -> None:
        self._running = running
        self._count = 0
        self._burst = True  # turns at the first look: it begins with a good time
        self._change_ns = running.start_ns
        self.apply: Callable[[Due, int], Due] = {
            Kind.OFF: self._off,
            Kind.LOSS: self._loss,
            Kind.BURST_LOSS: self._burst_loss,
            Kind.SLOW: self._slow,
            Kind.INTERMITTENT: self._intermittent,
            Kind.DELAYED: self._delayed,
            Kind.REORDER: self._reorder,
            Kind.DUPLICATE: self._duplicate,
        }[running.fault.kind]

    def _off(self, due: Due, now_ns: int) -> Due:
        del due, now_ns
        return []

    def _happens(self) -> bool:
        return bool(self._running.rng.random() < self._running.fault.amount)

    def _loss(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return [] if self._happens() else due

    def _burst_loss(self, due: Due, now_ns: int) -> Due:
        fault = self._running.fault
        while now_ns >= self._change_ns:
            self._burst = not self._burst
            mean_s = fault.amount if self._burst else fault.period
            self._change_ns += max(1, round(self._running.rng.exponential(mean_s) * NS))
        return [] if self._burst else due

    def _slow(self, due: Due, now_ns: int) -> Due:
        del now_ns
        self._count += 1
        return due if nth(self._running, self._count - 1) else []

    def _intermittent(self, due: Due, now_ns: int) -> Due:
        return [] if paused(self._running, now_ns) else due

    def _delayed(self, due: Due, now_ns: int) -> Due:
        del now_ns
        delay_ns = round(self._running.fault.amount * NS)
        return [at_ns + delay_ns for at_ns in due]

    def _reorder(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return [at_ns + HELD_BACK_NS for at_ns in due] if self._happens() else due

    def _duplicate(self, due: Due, now_ns: int) -> Due:
        del now_ns
        return due + due if self._happens() else due
