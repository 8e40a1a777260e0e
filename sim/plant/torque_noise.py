"""Torque on the body that nothing else explains: rotors that are not quite alike in their own disturbed air.

Each axis is an Ornstein-Uhlenbeck process, as the gusts of ``sim.plant.wind`` are.
"""

from __future__ import annotations

import math

from sim.compiled.jit import jitted
from sim.compiled.records import Record, Vector, new
from sim.plant.params import TorqueNoiseShape
from sim.plant.sensors import Tape, TapeRecord, take


class TorqueNoiseRecord(Record):
    """Torque on the body, body frame, N m."""

    now: Vector
    decay: Vector  # in one step
    kick: Vector  # standard deviation that one step adds
    on: bool
    noise: TapeRecord


@jitted
def shake(t: TorqueNoiseRecord) -> None:
    """Advance by one step; takes three numbers from the tape."""
    if t.on:
        for i in range(3):
            t.now[i] = t.decay[i] * t.now[i] + t.kick[i] * take(t.noise)


class TorqueNoise:
    """Sets up the torque noise of one vehicle.

    Args:
        shape: standard deviations and correlation times; off where all deviations are zero.
        seed: of the run.
        step_s: time between calls of ``shake``.
        record: where to keep everything; None for a place of its own.
    """

    def __init__(
        self, shape: TorqueNoiseShape, seed: int, step_s: float, record: TorqueNoiseRecord | None = None
    ) -> None:
        self.record = r = new(TorqueNoiseRecord) if record is None else record
        self._tape = Tape(seed, "torque.noise", r.noise)
        r.on = any(rms > 0.0 for rms in shape.rms_n_m)
        for i, (rms, time) in enumerate(zip(shape.rms_n_m, shape.time_s, strict=True)):
            decay = math.exp(-step_s / time)  # exact discretisation
            r.decay[i], r.kick[i] = decay, rms * math.sqrt(1.0 - decay**2)
            r.now[i] = rms * take(r.noise)  # stationary from the start

    def top_up(self) -> None:
        """Draw numbers for at least 340 steps."""
        self._tape.top_up()
