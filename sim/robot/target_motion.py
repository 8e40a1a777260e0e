"""The robot on a grid of ticks: its motion, its odometry, and the faults of both."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flightstack.compiled.records import F64, Values
from flightstack.core.types import Vec3
from sim.clock import TickGrid
from sim.faults.samples import SampleFaults, Shape
from sim.faults.schedule import Change, Running, ScheduledFaults
from sim.plant.sensors import NS
from sim.robot.target import Sample, TargetModel, TargetOdometry, wrap
from sim.scenarios.fault_spec import After, Fault, What
from sim.scenarios.scenario import Scenario


def _move(sample: Sample, offset: Vec3, turn: float) -> Sample:
    time_s, x, y, z, yaw, *twist = sample
    return (time_s, x + offset[0], y + offset[1], z + offset[2], wrap(yaw + turn), *twist)


SHAPE: Shape[Sample] = Shape(_move, lambda first, now: (now[0], *first[1:]))


class Wheels:
    """Faults that lock the robot's wheels."""

    locked = 0  # number of active faults that lock the wheels

    def begin(self, running: Running) -> None:
        del running
        self.locked += 1

    def end(self, running: Running, now_ns: int) -> None:
        del running, now_ns
        self.locked -= 1


class TargetFaults(ScheduledFaults):
    """Schedule and effects of the robot's faults; a delayed sample is returned by a later call.

    ``faults``: faults of the scenario; those of the vehicle are ignored.
    """

    def __init__(self, faults: Iterable[Fault], seed: int) -> None:
        self._samples, self._wheels = SampleFaults(SHAPE), Wheels()
        super().__init__(faults, seed, {What.ROBOT: self._wheels, What.TARGET_ODOMETRY: self._samples})

    @property
    def locked(self) -> bool:
        """Whether a fault locks the robot's wheels."""
        return self._wheels.locked > 0

    @property
    def waits_for_landing(self) -> bool:
        """Whether a fault waits for the start of the landing."""
        return self._schedule.waits_for(After.LANDING)

    def quiet_until(self, until_ns: int) -> bool:
        """Return whether no fault is active and none starts until ``until_ns``."""
        return not self.locked and not self._samples.active and until_ns < self._schedule.next_ns

    def landing_began(self, now_ns: int) -> None:
        """Start the faults that wait for the landing; further calls have no effect."""
        self._schedule.refer(After.LANDING, now_ns)

    def fail(self, faults: Iterable[Fault], now_ns: int) -> None:
        """Add faults, effective from the next sample; faults relative to ``time`` wait for their start."""
        self._schedule.add(faults, now_ns)

    def deliver(self, now_ns: int, samples: list[Sample]) -> list[Sample]:
        """Return the samples that the robot sends now; without faults it sends ``samples``."""
        if now_ns >= self._schedule.next_ns:
            self.run(now_ns)
        return self._samples.deliver(now_ns, samples) if self._samples.active else samples


class TargetMotion:
    """Model and odometry of the robot on a grid of ticks."""

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self.tick = 0  # current tick
        self.model = TargetModel(scenario.target, seed, step_s=grid.period_s)  # true motion at this tick
        self.faults = TargetFaults(scenario.fault, seed)  # faults of robot and odometry
        # whether the robot drives before the landing starts
        self.drives_at_once = not scenario.target.wait_for_landing
        self._odometry = TargetOdometry(scenario.odometry, seed)
        # substeps per tick; the odometry measures at most one sample per substep
        self._substeps = -(-round(scenario.odometry.rate_hz) // grid.rate_hz)
        self._step_s = grid.period_s / self._substeps
        self._texts: list[tuple[int, Change]] = []
        # pad and samples of tick 0, as ``run`` returns them
        self.first = self._driven([self.model.pad], [(0, sample) for sample in self._measure()])

    def run(self, ticks: int, driving: bool) -> tuple[F64, list[int], F64]:
        """Advance by several ticks, in compiled calls as long as no fault is active.

        Returns the pad's motion at each tick, (ticks, 12) values of a PadRecord; the index of the tick at
        which each sample was released; and the samples, (m, 9).
        """
        steps = ticks * self._substeps
        if self.faults.quiet_until(self.model.pad[0] + steps * round(self._step_s * NS)):
            pads = self.model.run(steps, self._step_s, driving)
            self.tick += ticks
            at, samples = self._odometry.run(pads)
            every = self._substeps
            return np.ascontiguousarray(pads[every - 1 :: every]), [n // every for n in at], samples
        decks, due = [], list[tuple[int, Sample]]()
        for n in range(ticks):
            self.tick += 1
            for _ in range(self._substeps):
                if self.faults.locked:
                    self.model.stop()
                self.model.step(self._step_s, driving and not self.faults.locked)
                due += [(n, sample) for sample in self._measure()]
            decks.append(self.model.pad)
        return self._driven(decks, due)

    def _driven(self, pads: list[Values], due: list[tuple[int, Sample]]) -> tuple[F64, list[int], F64]:
        samples = np.array([sample for _, sample in due], dtype=np.float64).reshape(len(due), 9)
        return np.array(pads, dtype=np.float64), [n for n, _ in due], samples

    def _measure(self) -> list[Sample]:
        _, samples = self._odometry.run(np.array([self.model.pad], dtype=np.float64))
        delivered = self.faults.deliver(round(self.model.time_s * 1e9), samples.tolist())
        self._texts += [(self.tick, text) for text in self.faults.take_texts()]
        return delivered

    def take_texts(self) -> list[tuple[int, Change]]:
        """Return the starts and ends of faults since the last call, each with its tick."""
        texts, self._texts = self._texts, []
        return texts
