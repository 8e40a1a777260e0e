"""Schedule of faults, used by the vehicle and by the robot."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from numpy.random import Generator

from sim.chance import stream
from sim.plant.sensors import NEVER_NS, NS
from sim.scenarios.fault_spec import After, Fault, What

TEXTS_MAX = 256  # maximum number of stored starts and ends; the oldest are dropped
RUNNING_MAX = 64  # maximum number of active faults; further commands are rejected


@dataclass(slots=True, eq=False)
class Running:
    """A scheduled or active fault, with its random stream."""

    fault: Fault
    rng: Generator
    start_ns: int = NEVER_NS
    end_ns: int = NEVER_NS
    active: bool = False
    over: bool = False

    def happens(self) -> bool:
        """Return at random whether the fault acts on this item; ``value`` is its probability."""
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


@dataclass(slots=True)
class Schedule:
    """Start and end of all faults; times are simulated, integer ns."""

    seed: int
    next_ns: int = NEVER_NS  # time of the next start or end
    _waiting: list[Running] = field(default_factory=list)  # faults whose reference event has not occurred
    _due: list[tuple[int, int, bool, Running]] = field(default_factory=list)
    _active: list[Running] = field(default_factory=list)
    _added: int = 0  # number of added faults, for the names of the random streams
    _planned: int = 0  # sequence number that orders events at equal times

    def add(self, faults: Iterable[Fault], now_ns: int = 0) -> None:
        """Add faults; faults relative to ``time`` count from zero, others wait for an event (``refer``)."""
        for fault in faults:
            rng = stream(self.seed, f"fault.{self._added}.{fault.what.value}.{fault.kind.value}")
            self._added += 1
            running = Running(fault, rng)
            if fault.after is After.TIME:
                self._plan(running, max(now_ns, round(fault.start_s * NS)))
            else:
                self._waiting.append(running)

    @property
    def active(self) -> tuple[Running, ...]:
        """Active faults in the order of their start."""
        return tuple(self._active)

    def waits_for(self, after: After) -> bool:
        """Whether a fault waits for this event."""
        return any(running.fault.after is after for running in self._waiting)

    def refer(self, after: After, now_ns: int) -> None:
        """Schedule the faults that waited for this event, which occurs now."""
        ready = [r for r in self._waiting if r.fault.after is after]
        self._waiting = [r for r in self._waiting if r.fault.after is not after]
        for running in ready:
            self._plan(running, now_ns + round(running.fault.start_s * NS))

    def due(self, now_ns: int) -> list[Change]:
        """Return starts and ends up to now, in order of time."""
        changes = []
        while self._due and self._due[0][0] <= now_ns:
            _, _, begins, running = heapq.heappop(self._due)
            if not running.over:  # no injected command has ended the fault earlier
                changes.append(self._begin(running) if begins else self.end(running))
        self.next_ns = self._due[0][0] if self._due else NEVER_NS
        return changes

    def _plan(self, running: Running, start_ns: int) -> None:
        running.start_ns = start_ns
        duration_s = running.fault.duration_s
        self._planned += 1
        order = self._planned
        heapq.heappush(self._due, (start_ns, order, True, running))
        if duration_s is not None:
            running.end_ns = start_ns + round(duration_s * NS)
            heapq.heappush(self._due, (running.end_ns, order, False, running))
        self.next_ns = self._due[0][0]

    def _begin(self, running: Running) -> Change:
        running.active = True
        self._active.append(running)
        return Change(running, begins=True)

    def end(self, running: Running) -> Change:
        """End an active fault now."""
        running.active, running.over = False, True
        self._active.remove(running)
        return Change(running, begins=False)


class Effect(Protocol):
    """Applies the faults of one component when they start and end."""

    def begin(self, running: Running) -> None: ...

    def end(self, running: Running, now_ns: int) -> None: ...


class ScheduledFaults:
    """Schedule and effects of the faults of some components; faults of other components are ignored."""

    def __init__(self, faults: Iterable[Fault], seed: int, effects: Mapping[What, Effect]) -> None:
        self._schedule, self._effects = Schedule(seed), effects
        self._schedule.add(fault for fault in faults if fault.what in effects)
        self._texts: deque[Change] = deque(maxlen=TEXTS_MAX)

    def run(self, now_ns: int) -> None:
        """Start and end due faults."""
        for change in self._schedule.due(now_ns):
            self._apply(change, now_ns)

    def take_texts(self) -> list[Change]:
        """Return the starts and ends of faults since the last call; their text is a message."""
        if not self._texts:
            return []
        texts = list(self._texts)
        self._texts.clear()
        return texts

    def _apply(self, change: Change, now_ns: int) -> None:
        effect = self._effects[change.running.fault.what]
        if change.begins:
            effect.begin(change.running)
        else:
            effect.end(change.running, now_ns)
        self._texts.append(change)
