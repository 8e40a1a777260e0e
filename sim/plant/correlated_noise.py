"""Time-correlated noise on three axes, for gusts and disturbance torques.

Each axis is an Ornstein-Uhlenbeck process.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record, Vector, new
from flightstack.core.types import Vec3
from sim.plant.sensors import Tape, TapeRecord, take


class NoiseRecord(Record):
    """State of the noise on three axes; values in units of their standard deviation."""

    now: Vector
    decay: Vector  # factor on the value in one step
    kick: Vector  # standard deviation of the noise that one step adds
    on: bool
    tape: TapeRecord


@jitted
def vary(n: NoiseRecord) -> None:
    """Advance the noise by one step; takes three numbers from the tape."""
    if n.on:
        for i in range(3):
            n.now[i] = n.decay[i] * n.now[i] + n.kick[i] * take(n.tape)


class CorrelatedNoise:
    """Correlated noise from one random stream.

    ``rms``: standard deviation of each axis, all zero for no noise; ``time_s``: correlation times;
    ``purpose``: name of the stream; ``step_s``: time between calls of ``vary``; ``record``: memory.
    """

    def __init__(
        self,
        rms: Vec3,
        time_s: Vec3,
        seed: int,
        purpose: str,
        step_s: float,
        record: NoiseRecord | None = None,
    ) -> None:
        self.record = r = new(NoiseRecord) if record is None else record
        self._tape = Tape(seed, purpose, r.tape)
        r.on = any(axis > 0.0 for axis in rms)
        for i, (axis, time) in enumerate(zip(rms, time_s, strict=True)):
            decay = math.exp(-step_s / time)  # exact discretisation
            r.decay[i], r.kick[i] = decay, axis * math.sqrt(1.0 - decay**2)
            r.now[i] = axis * take(r.tape)  # the process is stationary from the start

    def top_up(self) -> None:
        """Draw numbers for at least 340 steps."""
        self._tape.top_up()
