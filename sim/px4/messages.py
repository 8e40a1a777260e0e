"""Messages between PX4 and its simulator (PX4 docs, Simulator MAVLink API; SimulatorMavlink.cpp).

Pure functions, except for the noise of motion capture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from bridge.mavlink.codec.messages import Message
from bridge.mocap.checks import Passed
from bridge.mocap.vehicle import odometry
from bridge.ros2.cdr import Pose
from flightstack.core.types import Vec3
from sim.autopilot.ground import degrees_e7
from sim.plant.sensors import MeasurementChannel
from sim.px4.plant import Body
from sim.px4.sensors import Fix, Readings
from sim.scenarios.scenario import OdometryLink

RATE_MAX_HZ = 50.0  # maximum rate of poses, Hz; equal to the mocap bridge's
_SIGMA_MIN_M, _SIGMA_MIN_RAD = 1e-4, 1e-3  # minimum standard deviations; EKF2 needs a variance


class Px4Mocap:
    """Poses from motion capture; call ``poll`` at every step."""

    def __init__(self, link: OdometryLink, seed: int) -> None:
        link = replace(link, rate_hz=min(link.rate_hz, RATE_MAX_HZ))
        sigmas = (*[link.position_noise_m] * 3, link.yaw_noise_rad, 0.0, 0.0, 0.0, 0.0)
        self._channel = MeasurementChannel(link, sigmas, seed, "px4.mocap")
        place = max(link.position_noise_m, _SIGMA_MIN_M) ** 2
        turn = max(link.yaw_noise_rad, _SIGMA_MIN_RAD) ** 2
        diagonal = (place, place, place, turn, turn, turn)
        self._covariance = tuple(diagonal[i] if i == j else 0.0 for i in range(6) for j in range(6))

    def poll(self, body: Body, now_ns: int, now_us: int) -> list[Message]:
        """Measure when a sample is due; return ODOMETRY messages for the samples that have arrived.

        ``now_ns``: simulated time; ``now_us``: PX4's clock.
        """
        channel = self._channel
        if now_ns >= channel.due_ns:
            channel.sample(now_ns, (*body.position_enu_m, 0.0, *body.quaternion))
        if now_ns < channel.release_ns:
            return []
        return [self._odometry(values, now_us) for _, values in channel.release(now_ns)]

    def _odometry(self, values: Sequence[float], now_us: int) -> Message:
        x, y, z, yaw, w, i, j, k = values
        c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)  # a yaw error rotates the whole attitude
        attitude = (c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w)
        pose = Pose(now_us * 1000, "", (x, y, z), attitude, self._covariance)
        return odometry(Passed(pose, now_us * 1e-6, 0), now_us)


SYSTEM_ID, COMPONENT_ID = 1, 200  # ids of the simulator; PX4 ignores both

# bits of HIL_SENSOR.fields_updated; PX4 requires each group as a whole (SimulatorMavlink.hpp, SensorSource)
ACCEL, GYRO, MAG, BARO = 0b111, 0b111000, 0b111000000, 0b1101000000000

HIL_STATE_QUATERNION = 115
_ARMED = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_LOCKSTEP = 1  # bit of HIL_ACTUATOR_CONTROLS.flags that shows lockstep
_EPH_CM, _EPV_CM, _SATELLITES = 2, 4, 20
_INT16 = 32767
_COG_UNKNOWN = 65535
_COG_MIN_M_S = 0.2  # speed below which the course over ground is noise


class Answer(NamedTuple):
    """Content of one HIL_ACTUATOR_CONTROLS message."""

    time_us: int  # time on PX4's clock
    controls: tuple[float, ...]  # outputs 1 to 16
    armed: bool
    lockstep: bool  # whether PX4's clock is the simulator's clock


def answer_of(message: Message) -> Answer:
    armed, lockstep = bool(message.mode & _ARMED), bool(message.flags & _LOCKSTEP)
    return Answer(int(message.time_usec), tuple(message.controls), armed, lockstep)


def hil_sensor(time_us: int, readings: Readings) -> Message:
    """Return HIL_SENSOR with the new readings."""
    slow = readings.slow
    mag, hpa, altitude, celsius = (0.0, 0.0, 0.0), 0.0, 0.0, 0.0
    if slow is not None:
        mag, hpa = slow.mag_frd_gauss, slow.pressure_hpa
        altitude, celsius = slow.pressure_altitude_m, slow.temperature_c
    fields = ACCEL | GYRO | (MAG | BARO if slow is not None else 0)
    return dialect.MAVLink_hil_sensor_message(
        time_us, *readings.accel_frd_m_s2, *readings.gyro_frd_rad_s, *mag, hpa, 0.0, altitude, celsius, fields
    )


def hil_gps(time_us: int, fix: Fix) -> Message:
    north, east, _ = fix.velocity_ned_m_s
    speed = math.hypot(north, east)
    course = round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000
    return dialect.MAVLink_hil_gps_message(
        time_us, dialect.GPS_FIX_TYPE_RTK_FIXED,
        fix.latitude_e7, fix.longitude_e7, round(fix.altitude_amsl_m * 1e3), _EPH_CM, _EPV_CM,
        min(65534, round(speed * 100.0)), *_int16(fix.velocity_ned_m_s, 100.0),
        course if speed > _COG_MIN_M_S else _COG_UNKNOWN, _SATELLITES,
    )  # fmt: skip


def hil_state(time_us: int, body: Body, accel_frd_m_s2: Vec3, gravity_m_s2: float) -> Message:
    """Return HIL_STATE_QUATERNION, the true state; PX4 only logs it."""
    speed_cm_s = min(65535, round(math.hypot(*body.velocity_enu_m_s) * 100.0))
    x, y, z = body.position_enu_m
    return dialect.MAVLink_hil_state_quaternion_message(
        time_us, ned_frd_from_enu_flu(body.quaternion), *frd_from_flu(body.angular_velocity_flu_rad_s),
        *degrees_e7(x, y), round(z * 1e3), *_int16(ned_from_enu(body.velocity_enu_m_s), 100.0),
        speed_cm_s, speed_cm_s, *_int16(accel_frd_m_s2, 1000.0 / gravity_m_s2),
    )  # fmt: skip


def _int16(v: Vec3, scale: float) -> tuple[int, int, int]:
    a, b, c = (max(-_INT16, min(_INT16, round(x * scale))) for x in v)
    return (a, b, c)
