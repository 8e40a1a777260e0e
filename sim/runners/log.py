"""Log entries of the simulator: events, and true states of vehicle and deck.

A landing in one process has no log: ``Notes`` records its steps, true states and events. Their content equals
the log of the same flight with separate processes, so that one judge reads both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.core.controller import Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from logs.reader.flight_data import Event, Floats, Ints, Judged, Truth
from logs.recorder.feed import Feed
from logs.schema import Names, schemas
from logs.schema.events import ContactBit, Severity, pack_log
from logs.schema.rows import TrueStateRow
from sim.plant.states import truth_of, truth_row

# level in the log by MAV_SEVERITY, 0 (emergency) to 7 (debug)
_LEVELS = (
    Severity.FATAL, Severity.FATAL, Severity.ERROR, Severity.ERROR, Severity.WARN, Severity.INFO,
    Severity.INFO, Severity.DEBUG,
)  # fmt: skip
_CONTACTS = {
    ContactBit.PAD.value: (Severity.INFO, "contact with the pad"),
    ContactBit.GROUND.value: (Severity.INFO, "contact with the ground"),
    ContactBit.ROBOT.value: (Severity.WARN, "contact with the robot's body"),
    ContactBit.PAD_EDGE.value: (Severity.WARN, "contact with the pad's edge"),
    ContactBit.TUMBLED.value: (Severity.ERROR, "tumbled"),
    ContactBit.VEHICLE.value: (Severity.ERROR, "collision with another vehicle"),
}
_CONTACT_GAP_S = 0.5  # time without contact after which the next contact is a new event, s


class EventLog:
    """Writes the events of one process to ``/rosout``."""

    def __init__(self, feed: Feed, name: str, epoch_ns: int) -> None:
        self.feed = feed
        self.epoch_ns = epoch_ns
        self._name = name
        self._channel = feed.channel("/rosout", schemas.LOG)
        self._sequence = 0

    def event(self, now_ns: int, level: int, text: str) -> None:
        """Write one event; ``now_ns``: time since the epoch."""
        stamp_ns = self.epoch_ns + now_ns
        self._sequence += 1
        payload = pack_log(stamp_ns, level, self._name, text)
        self.feed.write(self._channel, stamp_ns, stamp_ns, self._sequence, payload)

    def statustext(self, now_ns: int, severity: int, text: str) -> None:
        """Write a status text of the autopilot."""
        self.event(now_ns, _LEVELS[severity], text)


class VehicleLog(EventLog):
    """Writes events and true states of the vehicle, and true states of the deck."""

    def __init__(self, feed: Feed, epoch_ns: int, names: Names) -> None:
        super().__init__(feed, names.logger("vehicle"), epoch_ns)
        self._truth = feed.channel(f"/{names.member}/sim/truth", schemas.TRUE_STATE)
        self._target = feed.channel(f"/{names.member}/sim/target/truth", schemas.ODOMETRY)
        self._contact_s: dict[int, float] = {}
        self._targets = 0

    def truth(self, tick: int, now_ns: int, values: Sequence[float]) -> None:
        """Write a true state (``TRUTH`` values); also write each new contact as an event."""
        stamp_ns = self.epoch_ns + now_ns
        row = truth_row(values, stamp_ns, tick)
        self.feed.write(self._truth, stamp_ns, stamp_ns, tick, row.pack())
        if row.contacts:
            self._contacts(now_ns, row.contacts)

    def target(self, now_ns: int, payload: bytes) -> None:
        """Write the message with the deck's true state, unchanged."""
        stamp_ns = self.epoch_ns + now_ns
        self._targets += 1
        self.feed.write(self._target, stamp_ns, stamp_ns, self._targets, payload)

    def _contacts(self, now_ns: int, contacts: int) -> None:
        now_s = now_ns * 1e-9
        for bit, (level, text) in _CONTACTS.items():
            if contacts & bit:
                last_s = self._contact_s.get(bit)
                if last_s is None or now_s - last_s > _CONTACT_GAP_S:
                    self.event(now_ns, level, text)
                self._contact_s[bit] = now_s


# names of the fields that are both in a true state and in the arrays of a flight
_SHARED = tuple(f.name for f in fields(Truth) if f.type == "Floats" and f.name in TrueStateRow._fields)


@dataclass(frozen=True)
class SeenSteps:
    """Data of n controller steps."""

    t_s: Floats  # (n,) time since the first tick
    phase: Ints  # (n,) value of ``Phase``
    own_age_s: Floats  # (n,) age of the vehicle's state estimate; NaN: no estimate
    target_age_s: Floats  # (n,) age of the target's state estimate; NaN: no estimate


@dataclass(frozen=True, kw_only=True)
class Seen(Judged):
    """Recorded data of a complete flight, as the judge needs it."""

    steps: SeenSteps
    truth: Truth
    config: FlightConfig


class Notes(VehicleLog):
    """Collects the data of a flight in this process, in place of the logs of vehicle and onboard process."""

    def __init__(self, config: FlightConfig, pad_radius_m: float, names: Names) -> None:
        super().__init__(Feed.connect(None, "vehicle", lossless=False), EPOCH_NS, names)
        self._config, self._pad_radius_m = config, pad_radius_m
        # for each step: time, ns; phase; ages of the states of vehicle and target, s
        self._times_ns: list[int] = []
        self._phases: list[int] = []
        self._own_ages_s: list[float] = []
        self._target_ages_s: list[float] = []
        # tick and time of each true state
        self._ticks: list[int] = []
        self._truth_times_ns: list[int] = []
        self._truths: list[Sequence[float] | Floats] = []  # each: ``TRUTH`` values of one or more states
        self._events: list[Event] = []

    def step(self, tick: Tick, out: Outputs) -> None:
        """Record phase, ages of the inputs, and events of a controller step."""
        seen = out.snapshot
        own, target = seen.inputs.own, seen.target
        own_age_s = tick.now_s - own.arrival_s if own is not None else math.nan
        target_age_s = target.age_s if target is not None else math.nan
        self._times_ns.append(tick.unix_ns - EPOCH_NS)
        self._phases.append(int(out.phase))
        self._own_ages_s.append(own_age_s)
        self._target_ages_s.append(target_age_s)
        for event in out.events:
            self.note(tick.now_s, event.level, "controller", event.text)

    def truth(self, tick: int, now_ns: int, values: Sequence[float]) -> None:
        """Record a true state."""
        self._ticks.append(tick)
        self._truth_times_ns.append(now_ns)
        self._truths.append(values)

    def target(self, now_ns: int, payload: bytes) -> None:
        """Do nothing: the true state contains the deck's state."""

    def batch(
        self, first: int, times_ns: Sequence[int], phase: Phase, ages_s: Floats, truths: Floats
    ) -> None:
        """Record steps and true states of consecutive ticks; a vehicle state arrived in each tick.

        ``first``: number of the first tick; ``times_ns``: times of the n ticks; ``phase``: phase of all
        ticks; ``ages_s``: (n,) age of the target state; ``truths``: (n, 41) values of the true states.
        """
        count = len(times_ns)
        self._times_ns += times_ns
        self._phases += [int(phase)] * count
        self._own_ages_s += [0.0] * count
        self._target_ages_s += ages_s.tolist()
        self._ticks += range(first, first + count)
        self._truth_times_ns += times_ns
        self._truths.append(truths)

    def event(self, now_ns: int, level: int, text: str) -> None:
        """Record an event of the vehicle."""
        self.note(now_ns * 1e-9, level, "vehicle", text)

    def note(self, t_s: float, level: int, source: str, text: str) -> None:
        """Record an event."""
        self._events.append(Event(t_s, level, source, text))

    def seen(self) -> Seen:
        """Return all recorded steps, true states and events as arrays."""
        return Seen(
            steps=SeenSteps(
                _seconds(self._times_ns),
                np.array(self._phases),
                np.array(self._own_ages_s),
                np.array(self._target_ages_s),
            ),
            truth=self._arrays(),
            events=tuple(sorted(self._events, key=lambda event: event.t_s)),
            config=self._config,
            pad_radius_m=self._pad_radius_m,
        )

    def _arrays(self) -> Truth:
        of: Any = truth_of(np.vstack(self._truths).T)
        columns = {name: np.ascontiguousarray(getattr(of, name).T) for name in _SHARED}
        return Truth(
            t_s=_seconds(self._truth_times_ns),
            tick=np.array(self._ticks),
            contacts=of.contacts.astype(np.int64),
            motors_running=of.motors_running.astype(np.bool_),
            **columns,
        )


def _seconds(times_ns: Sequence[int]) -> Floats:
    """Convert times in ns to seconds since the first tick, as in a log."""
    return np.asarray(np.array(times_ns, dtype=np.int64) * 1e-9, dtype=np.float64)
