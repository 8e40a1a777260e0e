"""Readings for PX4 against the truth they are made of, by formulas written down anew."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.autopilot.ground import ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG
from sim.plant.params import load
from sim.px4.plant import Body
from sim.px4.sensors import (
    ACCEL_MAX_M_S2,
    GYRO_MAX_RAD_S,
    Px4Sensors,
    field_ned_gauss,
    pressure_altitude_m,
    pressure_hpa,
)

LEVEL = (1.0, 0.0, 0.0, 0.0)  # nose to the east
G = 9.81
ANGLE = st.floats(-math.pi, math.pi)


def quaternion(yaw, pitch, roll):
    """Attitude FLU in ENU, turned about z, y, x."""

    def half(angle, axis):
        q = np.zeros(4)
        q[0], q[axis] = math.cos(angle / 2), math.sin(angle / 2)
        return q

    def times(a, b):
        return np.concatenate(
            [[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])]
        )

    return tuple(times(times(half(yaw, 3), half(pitch, 2)), half(roll, 1)))


def matrix_flu_enu(q):
    w, r = q[0], np.array(q[1:])
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


FRD = np.diag([1.0, -1.0, -1.0])
NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def body(q=LEVEL, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
    return Body(position, velocity, q, rates)


def many(state, count=500, seed=3):
    sensors = Px4Sensors(load(), state, seed)
    return [sensors.read(state) for _ in range(count)]


def mean(rows):
    return np.mean(np.array(list(rows)), axis=0)


def test_at_rest_the_accelerometer_reads_minus_g_down_in_frd_and_the_gyro_nothing():
    readings = many(body())
    assert mean(r.accel_frd_m_s2 for r in readings) == pytest.approx(
        [0.0, 0.0, -G], abs=0.12
    )  # bias 0.03 rms
    assert mean(r.gyro_frd_rad_s for r in readings) == pytest.approx([0.0, 0.0, 0.0], abs=0.005)


@settings(max_examples=40, deadline=None)
@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_at_rest_in_any_attitude_accelerometer_and_magnetometer_show_the_world_turned_into_the_body(
    yaw, pitch, roll
):
    q = quaternion(yaw, pitch, roll)
    readings = many(body(q), 50)
    ned_of_frd = NED_OF_ENU @ matrix_flu_enu(q) @ FRD
    accel = mean(r.accel_frd_m_s2 for r in readings)
    assert ned_of_frd @ accel == pytest.approx([0.0, 0.0, -G], abs=0.2)
    mag = mean(r.slow.mag_frd_gauss for r in readings if r.slow is not None)
    assert ned_of_frd @ mag == pytest.approx(field_ned_gauss(), abs=0.008)


@pytest.mark.parametrize(
    ("yaw_deg", "heading_deg"), [(90.0, 0.0), (0.0, 90.0), (-90.0, 180.0), (180.0, 270.0)]
)
def test_magnetic_heading_is_the_compass_heading_less_the_declination(yaw_deg, heading_deg):
    q = quaternion(math.radians(yaw_deg), 0.0, 0.0)
    x, y, z = mean(r.slow.mag_frd_gauss for r in many(body(q)) if r.slow is not None)
    magnetic = math.degrees(math.atan2(-y, x))
    assert math.remainder(magnetic + 3.27 - heading_deg, 360.0) == pytest.approx(0.0, abs=0.5)
    assert z > 0.4  # on the northern half the field points into the ground
    assert math.hypot(x, y, z) == pytest.approx(0.482, abs=0.003)


def test_acceleration_is_that_of_the_velocity_with_weight_in_the_body():
    sensors = Px4Sensors(load(), body(), 5)
    found = []
    for k in range(1, 201):
        v = 0.004 * k
        found.append(sensors.read(body(velocity=(2.0 * v, 1.0 * v, 3.0 * v))).accel_frd_m_s2)
    # nose east: forward is east, right is south
    assert mean(found) == pytest.approx([2.0, -1.0, -(G + 3.0)], abs=0.15)


def test_rates_to_the_right_and_nose_up_are_positive_in_frd():
    rates_flu = (0.5, -0.4, -0.3)  # right side down, nose up, clockwise from above
    found = mean(r.gyro_frd_rad_s for r in many(body(rates=rates_flu)))
    assert found == pytest.approx([0.5, 0.4, 0.3], abs=0.005)


def test_readings_stay_within_the_ranges_that_px4_keeps_as_16_bit_numbers():
    sensors = Px4Sensors(load(), body(), 1)
    hit = sensors.read(body(velocity=(5.0, -5.0, 5.0), rates=(100.0, -100.0, 0.0)))
    assert hit.accel_frd_m_s2 == (ACCEL_MAX_M_S2, ACCEL_MAX_M_S2, -ACCEL_MAX_M_S2)
    assert hit.gyro_frd_rad_s[:2] == (GYRO_MAX_RAD_S, GYRO_MAX_RAD_S)
    assert ACCEL_MAX_M_S2 / (9.80665 / 2048.0) < 32767
    assert math.degrees(GYRO_MAX_RAD_S) / (2000.0 / 32768.0) < 32767


@given(st.floats(-100.0, 3000.0))
def test_pressure_is_the_standard_atmosphere_s(altitude):
    assert pressure_altitude_m(pressure_hpa(altitude)) == pytest.approx(altitude, abs=1e-6)
    assert pressure_hpa(0.0) == 1013.25
    assert pressure_hpa(1000.0) == pytest.approx(898.75, abs=0.05)  # ISO 2533


@pytest.mark.parametrize("height", [0.0, 1.0, 30.0])
def test_barometer_shows_the_height(height):
    slow = [r.slow for r in many(body(position=(0.0, 0.0, height)), 2000) if r.slow is not None]
    assert mean([pressure_altitude_m(s.pressure_hpa)] for s in slow)[0] == pytest.approx(height, abs=0.02)
    assert np.std([s.pressure_altitude_m for s in slow]) == pytest.approx(0.10, abs=0.02)  # 1.2 Pa


@settings(max_examples=30, deadline=None)
@given(*[st.floats(-50.0, 50.0)] * 2, st.floats(0.0, 50.0), *[st.floats(-5.0, 5.0)] * 3)
def test_fix_shows_position_and_velocity(x, y, z, vx, vy, vz):
    fixes = [r.fix for r in many(body(position=(x, y, z), velocity=(vx, vy, vz)), 250) if r.fix is not None]
    assert len(fixes) == 10
    metres = 111_194.9  # of a degree on a sphere of 6371 km
    north = mean([(f.latitude_e7 * 1e-7 - ORIGIN_LATITUDE_DEG) * metres] for f in fixes)[0]
    east = mean([(f.longitude_e7 * 1e-7 - ORIGIN_LONGITUDE_DEG) * metres] for f in fixes)[0]
    east *= math.cos(math.radians(ORIGIN_LATITUDE_DEG))
    assert (north, east) == pytest.approx((y, x), abs=0.03)
    assert mean([f.altitude_amsl_m] for f in fixes)[0] == pytest.approx(z, abs=0.04)
    assert mean(f.velocity_ned_m_s for f in fixes) == pytest.approx([vy, vx, -vz], abs=0.1)


def test_rates_of_the_sensors():
    readings = many(body(), 250)  # a second
    assert sum(r.slow is not None for r in readings) == 50
    assert sum(r.fix is not None for r in readings) == 10
    assert readings[0].slow is not None
    assert readings[0].fix is None


def test_the_same_seed_gives_the_same_readings_and_another_one_does_not():
    assert many(body(), 100, 7) == many(body(), 100, 7)
    assert many(body(), 100, 7) != many(body(), 100, 8)
