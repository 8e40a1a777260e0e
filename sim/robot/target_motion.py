"""The ground robot tick by tick, apart from any wire: true motion, odometry, and what a fault does to it."""

from __future__ import annotations

from sim.clock import TickGrid
from sim.robot.fault_target import TargetFaults
from sim.robot.target import TargetMeasurement, TargetModel, TargetOdometry
from sim.scenarios.scenario import Scenario


class TargetMotion:
    """Model and odometry on a grid of ticks.

    Attributes:
        tick: where it is.
        model: true motion at that tick.
        faults: of the odometry.
        drives_at_once: whether it drives before the landing begins.
        due: samples released since somebody took them.
    """

    def __init__(self, scenario: Scenario, seed: int, grid: TickGrid) -> None:
        self.tick = 0
        self.model = TargetModel(scenario.target, seed, step_s=grid.period_s)
        self.faults = TargetFaults(scenario.fault, seed)
        self.drives_at_once = not scenario.target.wait_for_landing
        self._odometry = TargetOdometry(scenario.odometry, seed)
        # The odometry takes one sample a step at most.
        self._substeps = -(-round(scenario.odometry.rate_hz) // grid.rate_hz)
        self._step_s = grid.period_s / self._substeps
        self.due = self._measure()

    def step(self, driving: bool) -> None:
        """Go on to the next tick."""
        self.tick += 1
        for _ in range(self._substeps):
            self.model.step(self._step_s, driving)
            self.due += self._measure()

    def _measure(self) -> list[TargetMeasurement]:
        samples = self._odometry.step(self.model)
        return self.faults.deliver(round(self.model.time_s * 1e9), samples)
