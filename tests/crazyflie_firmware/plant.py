"""Point mass that follows velocities, falls without motors, and lands: vehicle of the firmware model."""

import math
from collections.abc import Callable

TAU_S = 0.12  # time constant of the firmware's PID velocity loop, s
G = 9.81
DRAG_1_S = 0.46  # deceleration by drag at level attitude, divided by the speed, 1/s


def variance_m2(pose_age_s: float) -> float:
    """Return the position variance of firmware 2026.08's filter, m^2, at this age of the last pose."""
    t = pose_age_s
    if t == math.inf:
        return 100.0
    return 5.6e-6 + 9.2e-5 * t**2 + 8.3e-5 * t**3 + 3.3e-5 * t**4 + 4.8e-5 * t**5


class Point:
    """Point-mass vehicle with exact state estimates; it stands on the surface ``surface_m(x, y)``."""

    def __init__(
        self, x: float = 0.0, y: float = 0.0, surface_m: Callable[[float, float], float] | None = None
    ):
        self.surface_m = surface_m or (lambda _x, _y: 0.0)
        self.position = [x, y, self.surface_m(x, y)]
        self.velocity = [0.0, 0.0, 0.0]
        self.yaw = self.yaw_rate = 0.0
        self.motors = False
        self._pose_age_s = math.inf
        self._wanted: list[float] | None = None
        self._level = False

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        return (math.cos(self.yaw / 2), 0.0, 0.0, math.sin(self.yaw / 2))

    @property
    def rates(self) -> tuple[float, float, float]:
        return (0.0, 0.0, self.yaw_rate)

    @property
    def estimate(self) -> tuple[list[float], list[float]]:
        """Return the estimated position and velocity, which equal the true values."""
        return self.position, self.velocity

    @property
    def variance_m2(self) -> float:
        return variance_m2(self._pose_age_s)

    def pose(self, x: float, y: float, z: float, quaternion_xyzw: tuple[float, ...] | None) -> None:
        self._pose_age_s = 0.0

    def know_drag(self, drag_1_s: tuple[float, float, float]) -> None:
        """Ignore ``kalman.dragB_*``, because this filter has no drag model."""

    def reset(self, x: float, y: float, z: float, yaw: float) -> None:
        """Ignore ``kalman.resetEstimation``, because this filter has no lasting error."""

    def restart(self) -> None:
        """Forget the last pose, which is the only state of this filter."""
        self._pose_age_s = math.inf

    @property
    def on_surface(self) -> bool:
        return self.position[2] <= self.surface_m(*self.position[:2]) + 1e-6

    def setpoint(self, velocity: tuple[float, float, float], yaw_rate: float) -> None:
        """Ignore a new set-point, because ``command`` receives the set-point in every step."""

    def command(self, velocity: tuple[float, float, float], yaw_rate: float, level: bool) -> None:
        """Set the commanded velocity; ``level``: zero tilt, only the vertical velocity is followed."""
        self._wanted, self._level, self.motors = list(velocity), level, True
        self.yaw_rate = 0.0 if level else yaw_rate

    def motors_off(self) -> None:
        self._wanted, self.motors, self.yaw_rate = None, False, 0.0

    def advance(self, dt_s: float) -> None:
        v = self.velocity
        if self._wanted is None:
            v[2] -= G * dt_s
        else:
            share = 1.0 - math.exp(-dt_s / TAU_S)
            for i in (0, 1):
                v[i] += -v[i] * DRAG_1_S * dt_s if self._level else (self._wanted[i] - v[i]) * share
            v[2] += (self._wanted[2] - v[2]) * share
        self._pose_age_s += dt_s
        for i in range(3):
            self.position[i] += v[i] * dt_s
        self.yaw += self.yaw_rate * dt_s
        floor_m = self.surface_m(*self.position[:2])
        if self.position[2] < floor_m:
            self.position[2] = floor_m
            self.velocity = [0.0, 0.0, max(0.0, v[2])]
