"""Motion capture for PX4 instead of satellites: ODOMETRY on its simulator link. Pure but for chance.

Rate (50 Hz at most), noise, delay and losses are the scenario's ``vehicle.mocap``. PX4 stamps a pose when it
comes (SimulatorMavlink.cpp), so that EKF2_EV_DELAY has to know the delay.
"""

from __future__ import annotations

import math
from dataclasses import replace

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import ned_covariance_from_enu, ned_frd_from_enu_flu, ned_from_enu, upper_triangle
from bridge.mavlink.codec.decoding import Message
from sim.plant.sensors import MeasurementChannel
from sim.px4.plant import Body
from sim.scenarios.scenario import OdometryLink

RATE_MAX_HZ = 50.0  # as of the bridge for motion capture
_SIGMA_MIN_M, _SIGMA_MIN_RAD = 1e-4, 1e-3  # a variance of zero would be believed for ever
_NAN6 = (math.nan,) * 6
_UNKNOWN = [math.nan, *([0.0] * 20)]  # NaN first: not known (MAVLink)


class Px4Mocap:
    """Call ``poll`` at every step.

    Args:
        link: of the scenario.
        seed: of the run.
    """

    def __init__(self, link: OdometryLink, seed: int) -> None:
        link = replace(link, rate_hz=min(link.rate_hz, RATE_MAX_HZ))
        sigmas = (*[link.position_noise_m] * 3, link.yaw_noise_rad, 0.0, 0.0, 0.0, 0.0)
        self._channel = MeasurementChannel(link, sigmas, seed, "px4.mocap")
        place = max(link.position_noise_m, _SIGMA_MIN_M) ** 2
        turn = max(link.yaw_noise_rad, _SIGMA_MIN_RAD) ** 2
        diagonal = (place, place, place, turn, turn, turn)
        enu = [diagonal[i] if i == j else 0.0 for i in range(6) for j in range(6)]
        self._covariance = list(upper_triangle(ned_covariance_from_enu(enu)))

    def poll(self, body: Body, now_ns: int, now_us: int) -> list[Message]:
        """Measure when it is due; ODOMETRY of what has arrived.

        Args:
            body: true state.
            now_ns: simulated time.
            now_us: PX4's clock.
        """
        channel = self._channel
        if now_ns >= channel.due_ns:
            channel.sample(now_ns, (*body.position_enu_m, 0.0, *body.quaternion))
        if now_ns < channel.release_ns:
            return []
        return [self._odometry(values, now_us) for _, values in channel.release(now_ns)]

    def _odometry(self, values: tuple[float, ...], now_us: int) -> Message:
        x, y, z, yaw, w, i, j, k = values
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)  # an error about the vertical turns everything
        attitude = (c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w)
        return dialect.MAVLink_odometry_message(
            now_us,
            dialect.MAV_FRAME_LOCAL_NED,
            dialect.MAV_FRAME_BODY_FRD,
            *ned_from_enu((x, y, z)),
            list(ned_frd_from_enu_flu(attitude)),
            *_NAN6,
            self._covariance,
            _UNKNOWN,
            0,
            dialect.MAV_ESTIMATOR_TYPE_VISION,
        )
