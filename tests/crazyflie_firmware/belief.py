"""What the firmware's Kalman filter makes of the truth: its errors to first order, without the filter.

Measured on firmware 2026.08: in flight the filter uses the accelerometer's body z alone. What else
accelerates the vehicle is unknown to it: rotor drag that ``kalman.dragB_*`` does not say, and gravity along
markers that are tilted against the body. With poses its velocity is wrong by that acceleration times 0.35 s
(0.34 s by the gains of kalman_core_params_defaults.h); without, the error integrates.
"""

import math
import random

NOISE_M = 0.0005  # of a position in flight, standard deviation (assumption: capture of 1 mm, filtered)
GAIN_S = 0.35  # s; 16 % of the velocity at a drag of 0.46 1/s
LOST_ACCELERATION_M_S2 = 0.33  # attitude not corrected any more: 0.65 m in 2.5 s; measured
LOST_S = 0.1  # s without a pose; ten are missing
UNKNOWN_M2 = 100.0  # before the first pose
G = 9.81


def variance_m2(pose_age_s: float) -> float:
    """Of a position: the filter's own covariance, propagated since the last pose."""
    t = pose_age_s
    if t == math.inf:
        return UNKNOWN_M2
    return 5.6e-6 + 9.2e-5 * t**2 + 8.3e-5 * t**3 + 3.3e-5 * t**4 + 4.8e-5 * t**5


class Belief:
    """Errors of position and velocity, and the variance, of a vehicle whose truth is known.

    Attributes:
        known_drag_1_s: ``kalman.dragB_x`` and ``_y``.
        position_error_m, velocity_error_m_s: what the filter has too much, x and y.
        rest_m_s: velocity along x that the accelerometer's bias shows at rest; measured.
    """

    def __init__(self) -> None:
        self.known_drag_1_s = (0.0, 0.0)
        self.rest_m_s = 0.009
        self.position_error_m = [0.0, 0.0]
        self.velocity_error_m_s = [0.0, 0.0]
        self._random = random.Random(0)
        self._tilted_m_s2 = (0.0, 0.0)
        self._pose_age_s = math.inf

    @property
    def variance_m2(self) -> float:
        return variance_m2(self._pose_age_s)

    def pose(self, x: float, y: float, z: float, w: float) -> None:
        """A pose has come, of a vehicle that is level."""
        self._pose_age_s = 0.0
        self._tilted_m_s2 = (2.0 * G * (x * z + w * y), 2.0 * G * (y * z - w * x))

    def advance(self, velocity: list[float], drag_1_s: float, flies: bool, dt_s: float) -> None:
        if self._pose_age_s == math.inf:
            return
        lost = self._pose_age_s > LOST_S
        self._pose_age_s += dt_s
        for i, rest_m_s, lost_m_s2 in ((0, self.rest_m_s, LOST_ACCELERATION_M_S2), (1, 0.0, 0.0)):
            error = self.velocity_error_m_s[i]
            unknown = self._tilted_m_s2[i] + lost_m_s2 * lost
            if flies:
                unknown += drag_1_s * velocity[i] - self.known_drag_1_s[i] * (velocity[i] + error)
            else:
                unknown += rest_m_s / GAIN_S
            self.velocity_error_m_s[i] += (unknown - (0.0 if lost else error / GAIN_S)) * dt_s
            self.position_error_m[i] += self.velocity_error_m_s[i] * dt_s
            if not lost:
                self.position_error_m[i] = self._random.gauss(0.0, NOISE_M) if flies else 0.0
