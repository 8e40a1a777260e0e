"""Wind (mean and gusts), and the time-correlated noise on three axes for gusts and disturbance torques.

Each axis is an Ornstein-Uhlenbeck process, dg = -g/T dt + rms sqrt(2/T) dW, with the first-order spectrum of
Dryden's longitudinal gusts. ``crazyflie20.toml`` has T and the vertical ratio.
"""

from __future__ import annotations

import math

from flightstack.compiled.jit import jitted
from flightstack.compiled.records import Record, Vector, new, reader
from flightstack.core.types import Vec3
from sim.chance import stream
from sim.plant.params import WindShape
from sim.plant.sensors import Tape, TapeRecord, take
from sim.scenarios.scenario import Wind


class NoiseRecord(Record):
    """State of the noise on three axes; each value is divided by its standard deviation."""

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
    ``purpose``: name of the stream; ``step_s``: time between calls of ``vary``;
    ``record``: record that stores the state.
    """

    def __init__(
        self, rms: Vec3, time_s: Vec3, seed: int, purpose: str, step_s: float,
        record: NoiseRecord | None = None,
    ) -> None:  # fmt: skip
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


class WindRecord(Record):
    """Wind at the vehicle, m/s, world ENU."""

    now: Vector
    steady: Vector  # mean wind, m/s ENU
    gust: NoiseRecord


@jitted
def blow(w: WindRecord) -> None:
    """Advance the gusts by one step; takes three numbers from their tape."""
    vary(w.gust)
    if w.gust.on:
        for i in range(3):
            w.now[i] = w.steady[i] + w.gust.now[i]


class WindModel:
    """Wind at the vehicle: ``x``, ``y``, ``z`` in m/s, world ENU.

    ``wind``: mean, gust rms, direction towards which the mean blows (None: drawn from the seed); ``shape``:
    correlation times, ratio of vertical to horizontal gust rms; ``step_s``: time between calls of ``step``;
    ``record``: record that stores the model's state.
    """

    def __init__(
        self, wind: Wind, shape: WindShape, seed: int, step_s: float, record: WindRecord | None = None
    ) -> None:
        self.record = r = new(WindRecord) if record is None else record
        self._read = reader(r.now)
        drawn = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
        direction = drawn if wind.direction_rad is None else wind.direction_rad
        self.mean_enu_m_s: Vec3 = (
            wind.mean_m_s * math.cos(direction),
            wind.mean_m_s * math.sin(direction),
            0.0,
        )
        r.steady[:] = self.mean_enu_m_s
        rms_h, rms_v = wind.gust_rms_m_s, wind.gust_rms_m_s * shape.vertical_share
        times = (shape.horizontal_time_s, shape.horizontal_time_s, shape.vertical_time_s)
        self._gust = CorrelatedNoise((rms_h, rms_h, rms_v), times, seed, "wind.gust", step_s, r.gust)
        r.now[:] = r.steady + r.gust.now

    def top_up(self) -> None:
        """Draw noise for at least 340 steps."""
        self._gust.top_up()

    def step(self) -> None:
        self.top_up()
        blow(self.record)

    @property
    def now_enu_m_s(self) -> Vec3:
        return self._read()
