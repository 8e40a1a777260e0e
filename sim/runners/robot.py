"""The ground robot on a grid of ticks: its motion, its odometry, and the faults of both.

``Robot`` computes some ticks ahead and returns true poses to the deck. ``DirectTarget`` also gives samples to
a controller in this process. Values equal those received over Zenoh: CDR carries doubles, so only the frame
rotations change them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, cast

import numpy as np

from bridge import frames
from bridge.frames import Quat
from flightstack.common.pacing import EPOCH_NS, NO_GO, RUN_AHEAD_TICKS
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, I64
from flightstack.core.types import TargetSample, Vec3
from flightstack.onboard.runner import NOTHING, Arrived
from logs.schema.events import Severity
from sim.clock import TickGrid
from sim.faults.samples import SampleFaults, Shape
from sim.faults.schedule import Component, ScheduledFaults
from sim.plant.sensors import NS
from sim.robot import Deck, Sample, TargetModel, TargetOdometry, wrap
from sim.scenarios.fault_spec import After, Fault, What
from sim.scenarios.scenario import Scenario

DRIVES_TICKS = 64  # maximum number of computed future ticks; on average half of them remain unused


def _move(sample: Sample, offset: Vec3, turn: float) -> Sample:
    time_s, x, y, z, yaw, *twist = sample
    return (time_s, x + offset[0], y + offset[1], z + offset[2], wrap(yaw + turn), *twist)


SHAPE: Shape[Sample] = Shape(_move, lambda first, now: (now[0], *first[1:]))


class TargetFaults(ScheduledFaults):
    """Schedule and effects of the robot's faults; a later ``deliver`` returns a delayed sample.

    ``faults``: faults of the scenario; those of the vehicle are ignored.
    """

    def __init__(self, faults: Iterable[Fault], seed: int) -> None:
        self._samples, self._wheels = SampleFaults(SHAPE), Component()
        super().__init__(faults, seed, {What.ROBOT: self._wheels, What.TARGET_ODOMETRY: self._samples})

    @property
    def locked(self) -> bool:
        """Whether a fault locks the robot's wheels."""
        return bool(self._wheels.running)

    def quiet_until(self, until_ns: int) -> bool:
        """Whether no fault is active and none starts until ``until_ns``."""
        return not self.locked and not self._samples.active and until_ns < self.change_ns

    def deliver(self, now_ns: int, samples: list[Sample]) -> list[Sample]:
        """Return the samples that the robot sends now; without faults it sends ``samples``."""
        if now_ns >= self.change_ns:
            self.run(now_ns)
        return self._samples.deliver(now_ns, samples) if self._samples.active else samples


class Ticks(NamedTuple):
    """Motion and samples of the robot in n consecutive ticks."""

    pads: F64  # (n, PAD) motion of the pad at each tick
    come: I64  # (n,) number of samples that the link has released up to each tick
    samples: F64  # (m, 9) released samples


class Robot:
    """A robot that computes its motion some ticks ahead, and may wait for the start of the landing.

    The number of future ticks is limited, so that the start of driving is known in time. A tick in a batch
    takes a fifth of the time of a single tick.
    """

    payload = b""  # message with the true pose at the newest tick; empty if the robot is not published

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self.tick = 0  # newest computed tick
        self.model = TargetModel(scenario.target, seed, step_s=grid.period_s)  # true motion at this tick
        self.faults = TargetFaults(scenario.fault, seed)  # faults of robot and odometry
        self._odometry = TargetOdometry(scenario.odometry, seed)
        # substeps per tick; the odometry measures at most one sample per substep
        self._substeps = -(-round(scenario.odometry.rate_hz) // grid.rate_hz)
        self._step_s = grid.period_s / self._substeps
        self._go_tick, self._grid = NO_GO, grid  # tick at which the robot starts to drive
        self._driving = not scenario.target.wait_for_landing

    def begin(self) -> None:
        """Compute tick 0. Raises NoAnswerError: a process that the robot needs was not ready in time."""
        self._keep(self.first_tick())

    def first_tick(self) -> Ticks:
        """Return motion and samples at tick 0."""
        row = self.model.row()
        samples = self._measure(row)
        return Ticks(row, np.array([len(samples)]), _rows(samples))

    def take(self, tick: int) -> Deck:
        """Advance to the next tick; return the true pose there."""
        raise NotImplementedError

    def await_credit(self, tick: int) -> None:
        """Wait until the companion permits this tick, if the robot depends on the companion."""

    def run_ahead(self, tick: int) -> None:
        """Compute future ticks while the companion computes, if that saves time."""

    @property
    def waits(self) -> bool:
        """Whether the start of the landing can still change the robot's path or faults."""
        return not self._driving or self.faults.waits_for(After.LANDING)

    def run(self, ticks: int, driving: bool) -> Ticks:
        """Advance by several ticks, in compiled calls as long as no fault is active."""
        every = self._substeps
        steps = ticks * every
        if self.faults.quiet_until(int(self.model.row()[0, 0]) + steps * round(self._step_s * NS)):
            pads = self.model.run(steps, self._step_s, driving)
            self.tick += ticks
            at, samples = self._odometry.run(pads)
            come = np.searchsorted(at, every * np.arange(1, ticks + 1))
            return Ticks(np.ascontiguousarray(pads[every - 1 :: every]), come, samples)
        rows, counts, due = list[F64](), list[int](), list[Sample]()
        for _ in range(ticks):
            self.tick += 1
            for _ in range(every):
                if self.faults.locked:
                    self.model.stop()
                row = self.model.run(1, self._step_s, driving and not self.faults.locked)
                due += self._measure(row)
            rows.append(row[0])
            counts.append(len(due))
        return Ticks(np.array(rows), np.array(counts), _rows(due))

    def _measure(self, row: F64) -> list[Sample]:
        _, samples = self._odometry.run(row)
        delivered = self.faults.deliver(int(row[0, 0]), samples.tolist())
        for fault in self.faults.take_texts():
            self._say(self.tick, Severity.WARN if fault.begins else Severity.INFO, str(fault))
        return delivered

    def _drive(self, until_tick: int) -> None:
        """Compute the motion of the robot, driving or at rest, up to a tick."""
        while self.tick < until_tick:
            end, goes_at = until_tick, self._go_tick
            if NO_GO < goes_at <= self.tick + 1:
                self.faults.refer(After.LANDING, self._grid.ns(goes_at))
                if not self._driving:
                    self._driving, now = True, self.tick + 1
                    self._say(now, Severity.INFO, f"the robot drives from tick {now} on")
            elif goes_at > NO_GO:
                end = min(end, goes_at - 1)  # faults relative to the landing's start are scheduled there
            self._keep(self.run(end - self.tick, self._driving))

    def _keep(self, new: Ticks) -> None:
        """Store the next ticks."""
        raise NotImplementedError

    def _say(self, tick: int, level: Severity, text: str) -> None:
        """Log an event of this tick, if the robot has a log."""


def _rows(samples: list[Sample]) -> F64:
    return np.array(samples, dtype=np.float64).reshape(-1, 9)


# compiled forms of the frame formulas of sender and receiver
_quaternion = cast("Callable[[float], Quat]", jitted(frames.quaternion_from_yaw))
_yaw = cast("Callable[[Quat], float]", jitted(frames.yaw_from_quaternion))
_turn = cast("Callable[[Quat, Vec3], Vec3]", jitted(frames.world_from_body))


@jitted
def _turn_samples(samples: F64, rows: F64) -> None:
    """Compute heading, and velocity and turn rate in the world frame, with the receiver's formulas.

    Quaternions are normalised; positions are copied.
    """
    for n in range(len(samples)):
        sample, row = samples[n], rows[n]
        w, x, y, z = _quaternion(sample[4])
        scale = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
        q = (w * scale, x * scale, y * scale, z * scale)
        velocity = _turn(q, (sample[5], sample[6], sample[7]))
        for i in range(3):
            row[1 + i], row[4 + i] = sample[1 + i], velocity[i]
        row[7], row[8] = _yaw(q), _turn(q, (0.0, 0.0, sample[8]))[2]


@jitted
def _decks(pads: F64, decks: F64) -> None:
    """Compute position, heading, velocity (world frame) and turn rate with the receiver's formulas."""
    for n in range(len(pads)):
        pad, deck, q = pads[n], decks[n], _quaternion(pads[n, 4])
        velocity = _turn(q, (pad[5], pad[6], pad[7]))
        for i in range(3):
            deck[i], deck[4 + i] = pad[1 + i], velocity[i]
        deck[3], deck[7] = _yaw(q), pad[11]


def deck_rows(pads: F64) -> F64:
    """Return position, heading, velocity and turn rate of the pad, (n, 8), from its motion, (n, 12)."""
    decks = np.empty((len(pads), 8))
    _decks(pads, decks)
    return decks


def deck_of(row: Sequence[float]) -> Deck:
    """Return the state in a row of ``deck_rows``."""
    x, y, z, yaw, vx, vy, vz, rate = row
    return Deck((x, y, z), yaw, (vx, vy, vz), rate)


class Ahead(NamedTuple):
    """Pad states and odometry samples of the robot at the next n ticks."""

    decks: F64  # (n, 8) position, heading, velocity and turn rate of the pad
    samples: F64  # (m, 9) time, position, velocity, heading and turn rate of the target
    come_before: int  # number of samples before the first tick
    come: I64  # (n,) number of samples up to each tick


class DirectTarget(Robot):
    """A robot that returns its true poses and samples directly, tick by tick."""

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        super().__init__(scenario, seed, grid)
        self._samples: list[list[float]] = []  # rows of ``Ahead.samples`` that were not read yet
        # data of the computed ticks, and number of those ticks already returned
        self._ahead, self._at = Ahead(np.empty((0, 8)), np.empty((0, 9)), 0, np.empty(0, np.int64)), 0
        # rows of ``Ahead.decks`` (pad motion) as lists; a list is read faster than an array row
        self._decks: list[list[float]] = []
        self._come: list[int] = []

    def take(self, tick: int) -> Deck:
        """Advance to this tick; return the true pose there."""
        if self._at == len(self._come):
            self._drive(tick + self._ahead_ticks - 1)
        first, end = self._come_before, self._come[self._at]
        if first != end:
            self._samples += self._ahead.samples[first:end].tolist()
        self._at += 1
        return deck_of(self._decks[self._at - 1])

    def ahead(self, tick: int, count: int) -> Ahead:
        """Return states and samples of the robot for up to ``count`` ticks, beginning at ``tick``."""
        if len(self._come) - self._at < count:
            self._drive(tick + self._ahead_ticks - 1)
        these, (decks, samples, _, come) = slice(self._at, self._at + count), self._ahead
        return Ahead(decks[these], samples, self._come_before, come[these])

    def skip(self, count: int) -> None:
        """Skip ticks that were flown as a batch."""
        self._at += count

    @property
    def _ahead_ticks(self) -> int:
        """Number of future ticks to compute; larger if no later input can change the path."""
        return RUN_AHEAD_TICKS if self.waits else DRIVES_TICKS

    @property
    def _come_before(self) -> int:
        """Number of samples up to the last returned tick."""
        return self._come[self._at - 1] if self._at else 0

    def _keep(self, new: Ticks) -> None:
        """Append states and samples of new ticks; drop the ticks already returned."""
        decks = deck_rows(new.pads)
        before, left = self._come_before, self._ahead
        samples = left.samples[before:]
        come = len(samples) + new.come
        if len(new.samples):
            samples = np.concatenate((samples, sample_rows(new.samples)))
        if self._at < len(self._come):
            decks = np.concatenate((left.decks[self._at :], decks))
            come = np.concatenate((left.come[self._at :] - before, come))
        self._at, self._ahead = 0, Ahead(decks, samples, 0, come)
        self._decks, self._come = decks.tolist(), come.tolist()

    def samples(self, now_s: float) -> Arrived:
        """Return the odometry released since the last call."""
        if not self._samples:
            return NOTHING
        due, self._samples = self._samples, []
        return Arrived(tuple([target_sample(now_s, row) for row in due]))

    def landing_began(self, tick: int) -> None:
        """Start to drive after the last tick that may already have been computed."""
        self._go_tick = tick + RUN_AHEAD_TICKS + 1


def sample_rows(samples: F64) -> F64:
    """Return the values of samples, (m, 9), as ``bridge.target.odometry.sample_of`` decodes them."""
    rows = np.empty_like(samples)
    rows[:, 0] = (EPOCH_NS + np.rint(samples[:, 0] * 1e9).astype(np.int64)) / 1e9
    _turn_samples(samples, rows)
    return rows


def target_sample(arrival_s: float, row: Sequence[float]) -> TargetSample:
    """Return the sample with the values of ``row``, one row of ``sample_rows``."""
    source_time_s, x, y, z, vx, vy, vz, yaw, rate = row
    return TargetSample(arrival_s, source_time_s, "map", "target", (x, y, z), (vx, vy, vz), yaw, rate)
