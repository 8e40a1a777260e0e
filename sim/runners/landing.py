"""One seeded landing in one process, noted and judged: ``land(scenario, seed)``, without sockets.

The same code as over the wires flies: the vehicle's lockstep loop with its autopilot and faults, the robot,
the companion's link and its runner of ticks. Only the wires are handed over directly, with their rounding;
so a landing equals ``flightstack sitl --lockstep`` of the same scenario and seed to the last bit.
"""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from bridge.mavlink.client.link import COMPONENT_ID as COMPANION_ID
from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.profiles.autopilots import OWN_SITL
from flightstack.common.hangup import Stop
from flightstack.common.pacing import EPOCH_NS, Tick
from flightstack.core.controller import Controller, Outputs
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from flightstack.onboard.leaving import Leaving
from flightstack.onboard.lockstep import VehicleTicks
from flightstack.onboard.runner import LinkedVehicle, Runner, Taken
from logs.reader.flight_data import Event, Floats, Ints, Truth
from logs.recorder.feed import Feed
from logs.verdict.truth import judge_truth
from logs.verdict.types import Verdict
from sim.autopilot.autopilot import COMPONENT_ID, SYSTEM_ID, Autopilot
from sim.clock import TickGrid
from sim.plant import vehicle_types
from sim.runners.landing_target import DirectTarget
from sim.runners.landing_wire import wires
from sim.runners.lockstep import LockstepLoop
from sim.runners.vehicle_log import VehicleLog
from sim.runners.vehicle_node import VehicleNode
from sim.scenarios.scenario import Scenario
from sim.vehicle.vehicle import VehicleSim

# names that the vehicle's true state shares with the log's
_SHARED = tuple(f.name for f in fields(Truth) if f.type == "Floats" and f.name in vehicle_types.Truth._fields)


@dataclass(frozen=True)
class SeenSteps:
    """Controller steps, n of them.

    Attributes:
        t_s: (n,) time.
        phase: (n,) ``Phase``.
        own_age_s: (n,) age of the own state, NaN without one.
        target_age_s: (n,) age of the target's, NaN without one.
    """

    t_s: Floats
    phase: Ints
    own_age_s: Floats
    target_age_s: Floats


@dataclass(frozen=True)
class Seen:
    """A flight as the judge looks at it (``logs.verdict.types.Judged``); always whole."""

    steps: SeenSteps
    truth: Truth
    events: tuple[Event, ...]
    config: FlightConfig
    pad_radius_m: float
    complete: bool = True
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    @cached_property
    def landing_start_s(self) -> float | None:
        """Time of the first step in phase APPROACH."""
        begun = np.flatnonzero(self.steps.phase == Phase.APPROACH)
        return float(self.steps.t_s[begun[0]]) if len(begun) else None


class Notes:
    """Collects while it flies."""

    def __init__(self, config: FlightConfig, pad_radius_m: float) -> None:
        self._config, self._pad_radius_m = config, pad_radius_m
        self._steps: list[tuple[int, int, float, float]] = []
        self._truth_ticks: list[tuple[int, int]] = []
        self._truth: list[vehicle_types.Truth] = []
        self._events: list[Event] = []

    def step(self, tick: Tick, out: Outputs) -> None:
        """Note a controller step."""
        seen = out.snapshot
        own, target = seen.inputs.own, seen.target
        own_age_s = tick.now_s - own.arrival_s if own is not None else math.nan
        target_age_s = target.age_s if target is not None else math.nan
        self._steps.append((tick.unix_ns - EPOCH_NS, int(out.phase), own_age_s, target_age_s))
        for event in out.events:
            self.event(tick.now_s, event.level, "controller", event.text)

    def truth(self, tick: int, now_ns: int, truth: vehicle_types.Truth) -> None:
        """Note a true state."""
        self._truth_ticks.append((tick, now_ns))
        self._truth.append(truth)

    def event(self, t_s: float, level: int, source: str, text: str) -> None:
        """Note something that was said."""
        self._events.append(Event(t_s, level, source, text))

    def seen(self) -> Seen:
        """All of it."""
        times_ns, phases, own_age_s, target_age_s = zip(*self._steps, strict=True)
        return Seen(
            SeenSteps(_seconds(times_ns), np.array(phases), np.array(own_age_s), np.array(target_age_s)),
            self._arrays(),
            tuple(sorted(self._events, key=lambda event: event.t_s)),
            self._config,
            self._pad_radius_m,
        )

    def _arrays(self) -> Truth:
        of = dict(zip(vehicle_types.Truth._fields, zip(*self._truth, strict=True), strict=True))
        columns = {name: _rows(of[name]) for name in _SHARED}
        ticks, times_ns = zip(*self._truth_ticks, strict=True)
        return Truth(
            t_s=_seconds(times_ns),
            tick=np.array(ticks),
            orientation=np.roll(_rows(of["quaternion"]), -1, axis=1),  # x, y, z, w
            contacts=np.array(of["contacts"]),
            motors_running=np.array(of["motors_running"]),
            **columns,
        )


class VehicleNotes(VehicleLog):
    """Stands in for the log of the vehicle's process."""

    def __init__(self, notes: Notes) -> None:
        super().__init__(Feed.connect(None, "vehicle", lossless=False), EPOCH_NS)
        self._notes = notes

    def truth(self, tick: int, now_ns: int, truth: vehicle_types.Truth) -> None:
        """Keep the true state."""
        self._notes.truth(tick, now_ns, truth)

    def target(self, now_ns: int, payload: bytes) -> None:
        """Not needed: the true state holds the deck's."""

    def event(self, now_ns: int, level: int, text: str) -> None:
        """Keep what was said."""
        self._notes.event(now_ns * 1e-9, level, "vehicle", text)


def _seconds(times_ns: Sequence[int]) -> Floats:
    """As in a log, whose time zero is the first tick's."""
    return np.asarray(np.array(times_ns, dtype=np.int64) * 1e-9, dtype=np.float64)


def _rows(values: Sequence[Any]) -> Floats:
    """Array of numbers, or of tuples of the same length; four times as fast as ``np.array`` with these."""
    if isinstance(values[0], tuple):
        width = len(values[0])
        flat = np.fromiter(chain.from_iterable(values), np.float64, len(values) * width)
        return flat.reshape(-1, width)
    return np.array(values, dtype=np.float64)


OnStep = Callable[[Tick, Outputs], None]


@dataclass(frozen=True)
class Landing:
    """What became of it.

    Attributes:
        seed: of all chance.
        verdict: judged from the true states, as a flight log is.
        seen: what a log of it would hold, as far as a verdict needs it.
        simulated_s: length.
        wall_s: time it took.
        retries: how often the landing was begun anew.
    """

    seed: int
    verdict: Verdict
    seen: Seen
    simulated_s: float
    wall_s: float
    retries: int


def land(scenario: Scenario, seed: int, *, on_step: OnStep | None = None) -> Landing:
    """Fly one landing and judge it.

    Args:
        scenario: everything that is not chance; its ``onboard`` part is flown.
        seed: chance.
        on_step: called after every controller step.

    Raises:
        RuntimeError: the simulation did not come to its end.
    """
    began_s = time.perf_counter()
    flight = _Companion(scenario, seed, on_step)
    seen = flight.fly()
    verdict = judge_truth(seen, seen.truth)
    simulated_s = float(seen.steps.t_s[-1])
    wall_s = time.perf_counter() - began_s
    return Landing(seed, verdict, seen, simulated_s, wall_s, flight.controller.memory.retries)


def keep_garbage_low() -> None:
    """Collect what a landing left; between landings the collector sleeps, as it does in the processes."""
    gc.collect()
    gc.disable()


class _Companion:
    """The onboard process, called by the vehicle's loop whenever that waits for its answer."""

    def __init__(self, scenario: Scenario, seed: int, on_step: OnStep | None) -> None:
        config = scenario.onboard
        rate_hz = config.loop.rate_hz
        self.controller = Controller(config)
        self._on_step = on_step
        self._stop = Stop()
        self._over = False
        grid = TickGrid(rate_hz)
        self._ticks_max = grid.count(scenario.duration_max_s + config.retreat.abort_time_max_s + 10.0)
        target = DirectTarget(scenario, seed, grid)
        here, there = wires((SYSTEM_ID, COMPONENT_ID), (SYSTEM_ID, COMPANION_ID))
        self._link = VehicleLink(
            "",
            takeoff_height_m=config.takeoff.height_m,
            profile=OWN_SITL,
            rate_hz=rate_hz,
            defer_timesync=True,
            endpoint=there,
            power=config.reserve is not None,
        )
        vehicle = VehicleSim(scenario, seed)
        autopilot = Autopilot(vehicle, rate_hz, trim_enu_m_s=vehicle.trim_velocity_enu_m_s)
        self._notes = Notes(config, scenario.target.pad_radius_m)
        node = VehicleNode(vehicle, autopilot, here, VehicleNotes(self._notes))
        here.answer = self._answer
        self._link.poll(0.0)  # says hello, as the process does before the first tick
        self._loop = LockstepLoop(node, target, grid, self._stop, scenario.vehicle.setpoint_delay_s)
        linked = LinkedVehicle(self._link, lockstep=True)
        leaving = Leaving(scenario.duration_max_s)
        self._runner = Runner(self.controller, VehicleTicks(linked, rate_hz), linked, target, leaving, self)

    def fly(self) -> Seen:
        """Run to the end."""
        self._loop.run(self._ticks_max)
        if not self._over:
            raise RuntimeError(f"the landing was not over after {self._ticks_max} ticks")
        return self._notes.seen()

    def _answer(self) -> None:
        if self._over:  # one true state after the last step, then the vehicle's process is ended, too
            self._stop.ask()
        else:
            self._over = self._runner.tick() is not None

    def write(self, tick: Tick, taken: Taken, out: Outputs, exec_s: float) -> None:
        """Note a tick."""
        del taken, exec_s
        self._notes.step(tick, out)
        for _, text in self._link.take_texts():
            self._notes.event(tick.now_s, 0, "onboard", f"vehicle: {text}")
        if self._on_step is not None:
            self._on_step(tick, out)
