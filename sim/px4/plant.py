"""The vehicle that a real PX4 flies: true state from rotor speeds, sensor readings, and the messages of both.

World, rotors, battery, wind, ground effect and deck use the functions of ``VehicleSim`` in steps of 1 ms; PX4
replaces the firmware. The result depends only on scenario, seed and commands. Messages use NED for the world
and FRD for the body. The IMU is read every 4 ms (250 Hz, IMU_INTEG_RATE of px4-rc.simulator). A reading has
the mean acceleration since the last reading and the current rates, both unfiltered, because PX4 filters them.
The messages follow the PX4 docs (Simulator MAVLink API) and SimulatorMavlink.cpp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from bridge.frames import body_from_world, enu_from_ned, frd_from_flu, ned_from_enu
from bridge.mavlink.codec.messages import Message
from bridge.mocap.checks import Passed
from bridge.mocap.process import odometry
from bridge.ros2.cdr import Pose
from flightstack.common.strict_toml import ConfigError
from flightstack.compiled.jit import jitted
from flightstack.compiled.records import F64, Cell
from flightstack.core.types import Vec3
from sim.autopilot.telemetry import degrees_e7
from sim.faults.samples import turned
from sim.plant.params import Params
from sim.plant.rotors import speed_limit
from sim.plant.sensors import Imu, MeasurementChannel, NoiseRows, measure
from sim.plant.states import Body, rotation_axes
from sim.scenarios.scenario import Scenario
from sim.scenarios.tables import OdometryLink, StartKind
from sim.vehicle.physics import (
    CONTROL_EVERY_MS,
    Physics,
    VehicleRecord,
    apply_ground_effect,
    move,
    push,
    surround,
)


@jitted
def fly_commanded(vehicle: Cell[VehicleRecord], wanted: F64, begin_ms: int, end_ms: int) -> None:
    """Run steps of 1 ms with these commanded rotor speeds (rpm, M1..M4); the battery limits them."""
    v = vehicle[0]
    for now_ms in range(begin_ms, end_ms):
        if now_ms % CONTROL_EVERY_MS == 0:
            limit = speed_limit(v.battery)
            for i in range(4):
                v.firmware.commands[i] = min(wanted[i], limit)
            apply_ground_effect(v)
        surround(v, now_ms)
        push(v)
        move(v, now_ms)


def start_position(scenario: Scenario, params: Params, pad_enu_m: Vec3) -> Vec3:
    """Return the start position on the floor: a ground start, or the point below a hover start."""
    z = -params.geometry.foot_bottom_m - 1e-5
    if scenario.start.kind is StartKind.GROUND:
        return (*scenario.start.ground_position_m, z)
    if scenario.start.offset_m is None:
        raise ConfigError(
            f"scenario {scenario.name!r}: found start.kind = 'hover' without start.offset_m; PX4 begins on "
            "the floor, so the place must be given: start.kind = 'ground', or start.offset_m"
        )
    return (pad_enu_m[0] + scenario.start.offset_m[0], pad_enu_m[1] + scenario.start.offset_m[1], z)


class Px4Plant(Physics):
    """One vehicle, which starts at rest on the floor, and its deck; set ``wanted`` before ``advance``."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        if scenario.fault:
            raise ConfigError(
                f"scenario {scenario.name!r}: found {len(scenario.fault)} [[fault]], allowed are none: "
                "faults act in the simulated firmware and links; take a scenario without them"
            )
        super().__init__(scenario, seed)
        self.record.motor_share[:] = 1.0
        self._ground_ms[0] = self._since_ms[0] = 0
        self.wanted = np.zeros(4)  # commanded rotor speeds of M1..M4, rpm
        self._world.set_vehicle(start_position(scenario, self.params, self._world.deck_pose[0]))

    def _fly(self, end_ms: int) -> int:
        fly_commanded(self.cell, self.wanted, self._ms, end_ms)
        return end_ms


STEP_MS = 4  # time between two IMU readings, ms
SLOW_EVERY = 5  # number of IMU readings per reading of magnetometer and barometer: 50 Hz
GPS_EVERY = 25  # number of IMU readings per satellite fix: 10 Hz

# World magnetic model 2020 at the room's origin, 47.397742 N 8.545594 E, interpolated from PX4's tables
# (geo_magnetic_tables.hpp, 2023.6), with which EKF2 compares the magnetometer.
DECLINATION_RAD = 0.05713
INCLINATION_RAD = 1.10208
STRENGTH_GAUSS = 0.48197
MAG_NOISE_GAUSS = 0.003  # rms noise: 0.3 uT, Bosch BMM150 data sheet

SEA_LEVEL_HPA, SEA_LEVEL_K, LAPSE_K_M, EXPONENT = 1013.25, 288.15, 0.0065, 5.25588  # values of ISO 2533
ZERO_CELSIUS_K = 273.15
BARO_NOISE_HPA = 0.012  # rms noise: 1.2 Pa, Bosch BMP388 data sheet

# assumed standard deviations of an RTK receiver, m; a pad of 0.1 m requires such a receiver
GPS_NOISE_M = (0.010, 0.010, 0.020)
GPS_NOISE_M_S = (0.03, 0.03, 0.05)

ACCEL_MAX_M_S2 = 156.8  # range of 16 g, stored as a 16 bit number in PX4 (SimulatorMavlink.cpp)
GYRO_MAX_RAD_S = math.radians(1999.9)  # range of 2000 deg/s, stored as a 16 bit number in PX4

SYSTEM_ID, COMPONENT_ID = 1, 200  # ids of the simulator; PX4 ignores both

# bits of HIL_SENSOR.fields_updated; PX4 requires each group as a whole (SimulatorMavlink.hpp, SensorSource)
ACCEL, GYRO, MAG, BARO = 0b111, 0b111000, 0b111000000, 0b1101000000000

_EPH_CM, _EPV_CM, _SATELLITES = 2, 4, 20
_INT16 = 32767
_COG_UNKNOWN = 65535
_COG_MIN_M_S = 0.2  # speed below which the course over ground is noise


_LEVEL = STRENGTH_GAUSS * math.cos(INCLINATION_RAD)
FIELD_NED_GAUSS: Vec3 = (
    _LEVEL * math.cos(DECLINATION_RAD), _LEVEL * math.sin(DECLINATION_RAD),
    STRENGTH_GAUSS * math.sin(INCLINATION_RAD),
)  # fmt: skip


def temperature_k(altitude_m: float) -> float:
    """Return the temperature of the standard atmosphere below 11 km."""
    return SEA_LEVEL_K - LAPSE_K_M * altitude_m


def pressure_hpa(altitude_m: float) -> float:
    """Return the pressure of the standard atmosphere below 11 km."""
    return float(SEA_LEVEL_HPA * (temperature_k(altitude_m) / SEA_LEVEL_K) ** EXPONENT)


def pressure_altitude_m(hpa: float) -> float:
    """Return the altitude for a pressure (inverse of ``pressure_hpa``)."""
    return float(SEA_LEVEL_K / LAPSE_K_M * (1.0 - (hpa / SEA_LEVEL_HPA) ** (1.0 / EXPONENT)))


def _within(flu: F64, limit: float) -> Vec3:
    """Convert a body vector from FLU to FRD, each component limited to ``limit``."""
    x, y, z = (max(-limit, min(limit, c)) for c in flu.tolist())
    return frd_from_flu((x, y, z))


class Px4Sensors:
    """All sensors of a vehicle that starts at rest, read every ``STEP_MS``; ``mocap`` replaces the GNSS."""

    def __init__(self, params: Params, body: Body, seed: int, mocap: OdometryLink | None = None) -> None:
        raw = replace(params.imu, gyro_filter_hz=math.inf, accel_filter_hz=math.inf)
        gravity = params.contact.gravity_m_s2
        self._imu = Imu(raw, gravity, STEP_MS * 1e-3, seed)
        self._imu.settle(body.velocity_enu_m_s, body_from_world(body.quaternion, (0.0, 0.0, gravity)))
        self._mag = NoiseRows((MAG_NOISE_GAUSS,) * 3, seed, "px4.mag")
        self._baro = NoiseRows((BARO_NOISE_HPA,), seed, "px4.baro")
        self._gps = NoiseRows((*GPS_NOISE_M, *GPS_NOISE_M_S), seed, "px4.gps")
        self._poses = Px4Mocap(mocap, seed) if mocap is not None else None
        self._count = 0

    def read(self, body: Body, now_us: int) -> list[Message]:
        """Return the readings that are due; HIL_SENSOR is the last, because it advances PX4's clock."""
        count, messages = self._count, []
        self._count += 1
        if self._poses is not None:
            messages = self._poses.poll(body, count * STEP_MS * 1_000_000, now_us)
        elif count % GPS_EVERY == GPS_EVERY - 1:  # PX4's clock has started before the first fix
            messages = [self._fix(body, now_us)]
        velocity, rates = np.array(body.velocity_enu_m_s), np.array(body.angular_velocity_flu_rad_s)
        self._imu.top_up()
        measure(self._imu.record, velocity, rates, rotation_axes(body.quaternion))
        accel = _within(self._imu.record.accel, ACCEL_MAX_M_S2)
        gyro = _within(self._imu.record.gyro, GYRO_MAX_RAD_S)
        fields: int = ACCEL | GYRO
        slow: tuple[float, ...] = (0.0,) * 7
        if count % SLOW_EVERY == 0:
            fields, slow = fields | MAG | BARO, self._slow(body)
        return [*messages, dialect.MAVLink_hil_sensor_message(now_us, *accel, *gyro, *slow, fields)]

    def _slow(self, body: Body) -> tuple[float, ...]:
        """Return magnetic field (3), G; pressure, differential pressure, hPa; altitude, m; temperature, C."""
        x, y, z = frd_from_flu(body_from_world(body.quaternion, enu_from_ned(FIELD_NED_GAUSS)))
        nx, ny, nz = self._mag.take(1)[0].tolist()
        height = body.position_enu_m[2]
        hpa = pressure_hpa(height) + self._baro.take(1).item()
        temperature_c = temperature_k(height) - ZERO_CELSIUS_K
        return x + nx, y + ny, z + nz, hpa, 0.0, pressure_altitude_m(hpa), temperature_c

    def _fix(self, body: Body, now_us: int) -> Message:
        nx, ny, nz, nu, nv, nw = self._gps.take(1)[0].tolist()
        x, y, z = body.position_enu_m
        vx, vy, vz = body.velocity_enu_m_s
        north, east, down = ned_from_enu((vx + nu, vy + nv, vz + nw))
        speed = math.hypot(north, east)
        course = round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000
        return dialect.MAVLink_hil_gps_message(
            now_us, dialect.GPS_FIX_TYPE_RTK_FIXED, *degrees_e7(x + nx, y + ny), round((z + nz) * 1e3),
            _EPH_CM, _EPV_CM, min(65534, round(speed * 100.0)), *map(_cm_s, (north, east, down)),
            course if speed > _COG_MIN_M_S else _COG_UNKNOWN, _SATELLITES,
        )  # fmt: skip


def _cm_s(speed_m_s: float) -> int:
    """Convert a speed to cm/s, limited to 16 bits."""
    return max(-_INT16, min(_INT16, round(speed_m_s * 100.0)))


RATE_MAX_HZ = 50.0  # maximum rate of poses, Hz; equal to that of the mocap bridge
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
        """Measure when a sample is due; return the samples that arrive. ``now_us``: PX4's clock."""
        values = np.array([(*body.position_enu_m, 0.0, *body.quaternion)])
        _, rows = self._channel.run([now_ns], values.__getitem__)
        return [self._odometry(row[1:], now_us) for row in rows.tolist()]

    def _odometry(self, values: Sequence[float], now_us: int) -> Message:
        x, y, z, yaw, *q = values
        attitude = turned((q[0], q[1], q[2], q[3]), yaw)  # a yaw error rotates the whole attitude
        pose = Pose(now_us * 1000, "", (x, y, z), attitude, self._covariance)
        return odometry(Passed(pose, now_us * 1e-6, 0), now_us)
