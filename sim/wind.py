"""Wind: a constant mean and gusts.

Each gust component is an Ornstein-Uhlenbeck process, dg = -g/T dt + rms sqrt(2/T) dW, the first-order
spectrum that Dryden's model has along the wind. T and the vertical share stand in ``crazyflie20.toml``.
"""

from __future__ import annotations

import math

from flightstack.types import Vec3
from sim.params import WindShape
from sim.scenario import Wind
from sim.sensors import Normals, stream


class WindModel:
    """Wind at the vehicle: ``x``, ``y``, ``z`` in m/s, world ENU.

    Args:
        wind: mean, gust rms, direction towards which the mean blows (drawn from the seed if None).
        shape: correlation times and vertical share.
        seed: of the run.
        step_s: time between calls of ``step``.
    """

    __slots__ = (
        "_decay_h", "_decay_v", "_gust", "_gx", "_gy", "_gz", "_kick_h", "_kick_v", "_normals",
        "mean_enu_m_s", "x", "y", "z",
    )  # fmt: skip

    def __init__(self, wind: Wind, shape: WindShape, seed: int, step_s: float) -> None:
        drawn = stream(seed, "wind.direction").uniform(-math.pi, math.pi)
        direction = drawn if wind.direction_rad is None else wind.direction_rad
        self.mean_enu_m_s: Vec3 = (
            wind.mean_m_s * math.cos(direction),
            wind.mean_m_s * math.sin(direction),
            0.0,
        )
        self._normals = Normals(seed, "wind.gust")
        self._gust = wind.gust_rms_m_s > 0.0
        rms_h, rms_v = wind.gust_rms_m_s, wind.gust_rms_m_s * shape.vertical_share
        self._decay_h = math.exp(-step_s / shape.horizontal_time_s)  # exact discretisation
        self._decay_v = math.exp(-step_s / shape.vertical_time_s)
        self._kick_h = rms_h * math.sqrt(1.0 - self._decay_h**2)
        self._kick_v = rms_v * math.sqrt(1.0 - self._decay_v**2)
        take = self._normals.take
        self._gx, self._gy, self._gz = (
            rms_h * take(),
            rms_h * take(),
            rms_v * take(),
        )  # stationary from the start
        self._add()

    def _add(self) -> None:
        mean = self.mean_enu_m_s
        self.x, self.y, self.z = mean[0] + self._gx, mean[1] + self._gy, mean[2] + self._gz

    def step(self) -> None:
        """Advance by ``step_s``."""
        if not self._gust:
            return
        take = self._normals.take
        self._gx = self._decay_h * self._gx + self._kick_h * take()
        self._gy = self._decay_h * self._gy + self._kick_h * take()
        self._gz = self._decay_v * self._gz + self._kick_v * take()
        self._add()
