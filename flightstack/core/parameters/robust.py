"""Assumptions of the robust filter about vehicle, target and links: numbers with units.

docs/how_it_works/robust_filter.md derives the margin from these numbers; `identify` measures the vehicle's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from flightstack.common.strict_toml import Each, span
from flightstack.core.numeric import hypot


@dataclass(frozen=True, slots=True)
class VelocityLoop:
    """Response of the vehicle to a velocity set-point, and gains of its correction.

    The defaults come from step responses of the Crazyflie firmware's PID loops on a simulated Crazyflie 2.0.
    """

    lag_xy_s: Annotated[float, span(0.0, 2.0)] = 0.27  # group delay of the closed loop at low frequency
    lag_z_s: Annotated[float, span(0.0, 2.0)] = 0.17  # group delay of the closed vertical loop
    # part of lag_xy_s before a horizontal set-point has an effect: delays of links and attitude
    dead_time_s: Annotated[float, span(0.0, 0.5)] = 0.0
    rate_xy_1_s: Annotated[float, span(0.5, 50.0)] = 5.2  # natural frequency of the second-order model
    rate_z_1_s: Annotated[float, span(0.5, 50.0)] = 8.0  # natural frequency of the vertical model
    damping: Annotated[float, span(0.1, 2.0)] = 0.68  # damping ratio of the model
    gain_xy: Annotated[float, span(0.0, 2.0)] = 0.6  # fraction of the tracking error added to the set-point
    gain_z: Annotated[float, span(0.0, 2.0)] = 0.5  # fraction of the vertical tracking error that is added
    # maximum difference between horizontal set-point and velocity; this limit bounds the tilt
    error_max_m_s: Annotated[float, span(0.05, 10.0)] = 0.6
    slope_time_s: Annotated[float, span(0.01, 1.0)] = 0.05  # time constant of the smoothed acceleration
    disturbance_time_s: Annotated[float, span(0.1, 10.0)] = 0.6  # time constant of the disturbance estimate
    disturbance_max_m_s: Annotated[float, span(0.0, 5.0)] = 0.6  # maximum disturbance; 0.25 in wind of 2 m/s

    def late_ticks(self, period_s: float) -> int:
        """Return the number of ticks from a horizontal set-point to its first effect."""
        return round(self.dead_time_s / period_s)

    def rate_max_1_s(self, period_s: float) -> float:
        """Return the natural frequency below which the model, stepped with this period, is stable.

        The matrix of one step (velocity_tracking.py) has the trace 2 - (wT)^2 - 2 zeta wT and the determinant
        1 - 2 zeta wT (w: natural frequency, zeta: damping, T: period). Jury: (wT)^2 + 4 zeta wT < 4.
        """
        return 2.0 * (math.hypot(self.damping, 1.0) - self.damping) / period_s


@dataclass(frozen=True, slots=True)
class VelocityFeedback:
    """Horizontal feedback of the whole vehicle state instead of the lead (strategies/velocity_tracking.py).

    The feedback rejects gusts. It needs an identified velocity loop, and more tilt than the wind requires.
    """

    horizontal: bool = False  # whether the feedback acts on x and y
    error_rate_1_s: Annotated[float, span(0.5, 20.0)] = 5.0  # correction rate of a velocity error
    tilt_rate_1_s: Annotated[float, span(1.0, 50.0)] = 13.0  # response rate of the tilt to its command
    observer_rate_1_s: Annotated[float, span(1.0, 50.0)] = 25.0  # rate of the disturbance estimate
    acceleration_max_m_s2: Annotated[float, span(0.2, 20.0)] = 3.0  # maximum commanded acceleration
    # distance from the landing spot beyond which the far rates apply (slower tilt saves thrust); 0: never
    far_m: Annotated[float, span(0.0, 100.0)] = 0.0
    far_error_rate_1_s: Annotated[float, span(0.5, 20.0)] = 4.0  # error_rate_1_s beyond far_m
    far_tilt_rate_1_s: Annotated[float, span(1.0, 50.0)] = 8.0  # tilt_rate_1_s beyond far_m

    @property
    def far(self) -> VelocityFeedback:
        """These parameters with the far rates; unchanged if ``far_m`` is 0."""
        if not self.far_m:
            return self
        return replace(self, error_rate_1_s=self.far_error_rate_1_s, tilt_rate_1_s=self.far_tilt_rate_1_s)


@dataclass(frozen=True, slots=True)
class OwnStateLink:
    """Delay and errors of the received vehicle state."""

    delay_s: Annotated[float, span(0.0, 0.2)] = 0.01  # age of a vehicle state on arrival
    position_noise_m: Annotated[float, span(0.0, 0.2)] = 0.002  # standard deviation of a position, per axis
    # standard deviation of the estimated velocity error on each axis; 0: no velocity error
    velocity_error_m_s: Annotated[float, span(0.0, 0.5)] = 0.0
    # correlation time T of the velocity error, exp(-t/T); without velocity feedback: estimation time
    velocity_error_time_s: Annotated[float, span(0.05, 20.0)] = 0.5
    velocity_error_max_m_s: Annotated[float, span(0.0, 1.0)] = 0.2  # limit of the estimated velocity error

    @property
    def learns(self) -> bool:
        """Whether the velocity error is estimated."""
        return self.velocity_error_m_s > 0.0


@dataclass(frozen=True, slots=True)
class TargetLink:
    """Motion of the target, and delay and noise of its odometry."""

    delay_s: Annotated[float, span(0.0, 0.5)] = 0.02  # minimum age of a sample on arrival
    position_noise_m: Annotated[float, span(1e-4, 0.5)] = 0.005  # standard deviation of a position, per axis
    velocity_noise_m_s: Annotated[float, span(1e-4, 1.0)] = 0.02  # standard deviation of a velocity, per axis
    # density of the jerk; with 0.6 the acceleration changes by about 0.5 m/s^2 in 1 s
    jerk_xy_m_s3_sqrthz: Annotated[float, span(0.01, 20.0)] = 0.6
    jerk_z_m_s3_sqrthz: Annotated[float, span(0.01, 20.0)] = 0.02  # vertical jerk density; 0.6 on a ship
    # maximum factor on the jerk of x and y while innovations are larger than expected; 1: constant jerk
    jerk_growth_max: Annotated[float, span(1.0, 100.0)] = 1.0
    # initial standard deviation of the acceleration on x and y
    acceleration_xy_m_s2: Annotated[float, span(0.001, 10.0)] = 0.3
    # time constant with which the estimated acceleration on x and y decays
    acceleration_time_s: Annotated[float, span(0.05, 1000.0)] = 0.5
    turns_with_yaw: bool = True  # whether velocity turns with yaw; false for a robot that moves sideways
    # initial standard deviation of the vertical acceleration
    acceleration_z_m_s2: Annotated[float, span(0.001, 10.0)] = 0.01


@dataclass(frozen=True, slots=True)
class Envelope:
    """Range of conditions that the certificate covers, with ``touchdown.target_speed_max_m_s``."""

    target_climb_max_m_s: Annotated[float, span(0.0, 2.0)] = 0.0  # maximum vertical speed of the pad
    target_acceleration_max_m_s2: Annotated[float, span(0.0, 10.0)] = 0.5  # maximum acceleration of a target
    target_rate_hz: Annotated[float, span(1.0, 500.0)] = 50.0  # rate of the target's odometry
    lag_spread: Annotated[float, span(0.0, 0.9)] = 0.3  # relative tolerance of the vehicle's lag, up and down


@dataclass(frozen=True, slots=True)
class Robust:
    """Parameters of the robust filter."""

    rate_1_s: Annotated[float, span(0.1, 10.0)] = 1.5  # maximum decay rate of h; the velocity loop is faster
    # upper limit of the error by which the vertical velocity is below its command
    tracking_error_m_s: Annotated[float, span(0.0, 1.0)] = 0.04
    sigma_factor: Annotated[float, span(0.0, 6.0)] = 2.0  # number of covered standard deviations of positions
    fade_radius_m: Annotated[float, span(0.01, 1.0)] = 0.06  # radius within which the margin fades
    # maximum acceleration of the commanded velocity along east, north and up
    acceleration_max_m_s2: Each[Annotated[float, span(0.2, 20.0)]] = (2.0, 2.0, 2.5)
    gain_1_s: Annotated[float, span(0.1, 5.0)] = 1.2  # gain of the position loop on the approach
    gain_over_pad_1_s: Annotated[float, span(0.1, 5.0)] = 2.0  # horizontal gain over the pad
    gain_descent_1_s: Annotated[float, span(0.0, 5.0)] = 0.0  # gain in the final descent; 0: as over the pad
    descent_min_m_s: Annotated[float, span(0.01, 1.0)] = 0.1  # minimum descent speed above the waiting height
    descent_max_m_s: Annotated[float, span(0.05, 10.0)] = 1.0  # maximum descent speed, relative to the pad
    wait_height_m: Annotated[float, span(0.03, 3.0)] = 0.1  # height of the wait before the final descent
    commit_height_m: Annotated[float, span(0.05, 3.0)] = 0.22  # height below which the final descent starts
    # maximum distance from the centre at which the final descent starts
    commit_radius_m: Annotated[float, span(0.005, 1.0)] = 0.04
    # maximum speed relative to the target at which the final descent starts
    commit_speed_m_s: Annotated[float, span(0.01, 1.0)] = 0.12
    corridor_m: Annotated[float, span(0.01, 2.0)] = 0.085  # radius of the corridor; outside: go-around
    descent_m_s: Annotated[float, span(0.05, 1.0)] = 0.22  # speed of the final descent relative to the pad
    descent_lead_max_m_s: Annotated[float, span(0.0, 1.0)] = 0.15  # maximum lead of the final descent
    touch_height_m: Annotated[float, span(0.005, 0.5)] = 0.05  # height below which a stop means contact

    @property
    def to_contact_1_s(self) -> float:
        """Gain of the horizontal position loop in the final descent."""
        return self.gain_descent_1_s or self.gain_over_pad_1_s

    def margin_m(self, slope: float, sigma_xy_m: float, sigma_z_m: float) -> float:
        """Return the margin on h that covers tracking and position errors, m."""
        position_m = self.sigma_factor * hypot(slope * sigma_xy_m, sigma_z_m)
        return self.tracking_error_m_s / self.rate_1_s + position_m
