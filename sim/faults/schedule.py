"""Schedule of faults, used by the vehicle and by the robot."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from numpy.random import Generator

from sim.chance import stream
from sim.plant.sensors import NEVER_NS, NS
from sim.scenarios.fault_spec import After, Fault, What

TEXTS_MAX = 256  # maximum number of stored starts and ends of faults; the oldest are dropped


@dataclass(slots=True, eq=False)
class Running:
    """A scheduled or active fault, with its random stream."""

    fault: Fault
    rng: Generator
    start_ns: int = NEVER_NS
    over: bool = False
    memory: Any = None  # state of the effect; None before its first use

    def happens(self) -> bool:
        """Draw whether the fault acts on this item; the fault's key ``value`` is the probability."""
        return bool(self.rng.random() < self.fault.amount)

    def paused(self, now_ns: int) -> bool:
        """Whether an intermittent fault pauses now; its first period starts with a pause."""
        since_s = (now_ns - self.start_ns) / NS
        return since_s % self.fault.period < self.fault.amount


class Change(NamedTuple):
    """Start or end of a fault."""

    running: Running
    begins: bool

    def __str__(self) -> str:
        return f"Fault{'' if self.begins else ' over'}: {self.running.fault.text}"


class Component:
    """A component that fails; ``running`` has its active faults in the order of their start."""

    def __init__(self) -> None:
        self.running: list[Running] = []

    def begin(self, running: Running) -> None:
        self.running.append(running)

    def end(self, running: Running, now_ns: int) -> None:
        del now_ns
        self.running.remove(running)


class ScheduledFaults:
    """Starts and ends the given faults of ``components``; times are simulated, integer ns."""

    def __init__(self, faults: Iterable[Fault], seed: int, components: Mapping[What, Component]) -> None:
        self._seed, self._components = seed, components
        self.change_ns = NEVER_NS  # time of the next start or end
        self._waiting: list[Running] = []  # faults whose reference event has not occurred
        self._due: list[tuple[int, int, bool, Running]] = []
        self._added = 0  # number of added faults, for the names of the random streams
        self._planned = 0  # sequence number that orders events at equal times
        self._texts: deque[Change] = deque(maxlen=TEXTS_MAX)
        self.add((fault for fault in faults if fault.what in components), 0)

    def add(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Add faults: those relative to ``time`` are scheduled, the others wait for an event (``refer``)."""
        for fault in faults:
            rng = stream(self._seed, f"fault.{self._added}.{fault.what.value}.{fault.kind.value}")
            self._added += 1
            running = Running(fault, rng)
            if fault.after is After.TIME:
                self._plan(running, max(now_ns, round(fault.start_s * NS)))
            else:
                self._waiting.append(running)

    def waits_for(self, after: After) -> bool:
        """Whether a fault waits for this event."""
        return any(running.fault.after is after for running in self._waiting)

    def refer(self, after: After, now_ns: int) -> None:
        """Schedule the faults that waited for this event, which occurs now; repeated calls have no effect."""
        ready = [r for r in self._waiting if r.fault.after is after]
        self._waiting = [r for r in self._waiting if r.fault.after is not after]
        for running in ready:
            self._plan(running, now_ns + round(running.fault.start_s * NS))

    def run(self, now_ns: int) -> None:
        """Start and end the faults up to now, in order of time."""
        while self._due and self._due[0][0] <= now_ns:
            _, _, begins, running = heapq.heappop(self._due)
            component = self._components[running.fault.what]
            if begins:
                component.begin(running)
            else:
                running.over = True
                component.end(running, now_ns)
            self._texts.append(Change(running, begins))
        self.change_ns = self._due[0][0] if self._due else NEVER_NS

    def take_texts(self) -> list[Change]:
        """Return the starts and ends of faults since the last call; ``str`` of each is a message."""
        texts = list(self._texts)
        self._texts.clear()
        return texts

    def _plan(self, running: Running, start_ns: int) -> None:
        running.start_ns = start_ns
        duration_s = running.fault.duration_s
        self._planned += 1
        heapq.heappush(self._due, (start_ns, self._planned, True, running))
        if duration_s is not None:
            heapq.heappush(self._due, (start_ns + round(duration_s * NS), self._planned, False, running))
        self.change_ns = self._due[0][0]
