"""Tests the simulated readings of PX4's sensors and of motion capture."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from sim.autopilot.telemetry import ORIGIN_LATITUDE_DEG, ORIGIN_LONGITUDE_DEG
from sim.plant.params import load
from sim.plant.states import Body
from sim.px4.plant import FIELD_NED_GAUSS, Px4Mocap, Px4Sensors, pressure_altitude_m
from sim.scenarios.tables import OdometryLink
from tests.examples import examples

LEVEL = (1.0, 0.0, 0.0, 0.0)  # attitude with the nose to the east
G = 9.81
ANGLE = st.floats(-math.pi, math.pi)


def quaternion(yaw, pitch, roll):
    """Return the attitude, FLU to ENU, after rotations about z, y and x, rad."""

    def half(angle, axis):
        q = np.zeros(4)
        q[0], q[axis] = math.cos(angle / 2), math.sin(angle / 2)
        return q

    def times(a, b):
        return np.concatenate(
            [[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])]
        )

    return tuple(times(times(half(yaw, 3), half(pitch, 2)), half(roll, 1)))


def rotation(q):
    w, r = q[0], np.array(q[1:])
    cross = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


FRD = np.diag([1.0, -1.0, -1.0])
NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def body(q=LEVEL, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
    return Body(position, velocity, q, rates)


SLOW_BITS = 0b1101111000000  # bits of magnetometer and barometer in fields_updated


def received(message):
    """Return a message as PX4 receives it."""
    (found,) = mav.MAVLink(None).parse_buffer(bytes(message.pack(mav.MAVLink(None, 1, 200))))
    return found


def many(state, count=500, seed=3):
    """Return the HIL_SENSOR and the HIL_GPS messages of this many steps."""
    sensors = Px4Sensors(load(), state, seed)
    found = [received(message) for k in range(count) for message in sensors.read(state, 4000 * k)]
    return tuple([m for m in found if m.get_type() == kind] for kind in ("HIL_SENSOR", "HIL_GPS"))


def accel(message):
    return message.xacc, message.yacc, message.zacc


def mean(rows):
    return np.mean(np.array(list(rows)), axis=0)


@examples(15)
@given(ANGLE, st.floats(-1.5, 1.5), ANGLE)
def test_at_rest_in_any_attitude_accelerometer_and_magnetometer_show_the_world_turned_into_the_body(
    yaw, pitch, roll
):
    q = quaternion(yaw, pitch, roll)
    readings, _ = many(body(q), 50)
    ned_of_frd = NED_OF_ENU @ rotation(q) @ FRD
    assert ned_of_frd @ mean(map(accel, readings)) == pytest.approx([0.0, 0.0, -G], abs=0.2)
    mag = mean((r.xmag, r.ymag, r.zmag) for r in readings if r.fields_updated & SLOW_BITS)
    assert ned_of_frd @ mag == pytest.approx(FIELD_NED_GAUSS, abs=0.008)


def test_acceleration_is_that_of_the_velocity_with_weight_in_the_body():
    sensors = Px4Sensors(load(), body(), 5)
    found = []
    for k in range(1, 201):
        v = 0.004 * k
        found.append(accel(sensors.read(body(velocity=(2.0 * v, 1.0 * v, 3.0 * v)), 4000 * k)[-1]))
    # nose east: forward is east, right is south
    assert mean(found) == pytest.approx([2.0, -1.0, -(G + 3.0)], abs=0.15)


def test_rates_to_the_right_and_nose_up_are_positive_in_frd():
    rates_flu = (0.5, -0.4, -0.3)  # right side down, nose up, clockwise from above
    found = mean((r.xgyro, r.ygyro, r.zgyro) for r in many(body(rates=rates_flu))[0])
    assert found == pytest.approx([0.5, 0.4, 0.3], abs=0.005)


@pytest.mark.parametrize("height", [0.0, 1.0, 30.0])
def test_barometer_shows_the_height(height):
    slow = [m for m in many(body(position=(0.0, 0.0, height)), 2000)[0] if m.fields_updated & SLOW_BITS]
    assert mean([pressure_altitude_m(s.abs_pressure)] for s in slow)[0] == pytest.approx(height, abs=0.02)
    assert np.std([s.pressure_alt for s in slow]) == pytest.approx(0.10, abs=0.02)  # 0.10 m are 1.2 Pa


@examples(15)
@given(*[st.floats(-50.0, 50.0)] * 2, st.floats(0.0, 50.0), *[st.floats(-5.0, 5.0)] * 3)
def test_fix_shows_position_and_velocity(x, y, z, vx, vy, vz):
    _, fixes = many(body(position=(x, y, z), velocity=(vx, vy, vz)), 250)
    assert len(fixes) == 10
    metres = 111_194.9  # length of a degree on a sphere of 6371 km
    north = mean([(f.lat * 1e-7 - ORIGIN_LATITUDE_DEG) * metres] for f in fixes)[0]
    east = mean([(f.lon * 1e-7 - ORIGIN_LONGITUDE_DEG) * metres] for f in fixes)[0]
    east *= math.cos(math.radians(ORIGIN_LATITUDE_DEG))
    assert (north, east) == pytest.approx((y, x), abs=0.03)
    assert mean([f.alt * 1e-3] for f in fixes)[0] == pytest.approx(z, abs=0.04)
    assert mean((f.vn, f.ve, f.vd) for f in fixes) == pytest.approx(np.array([vy, vx, -vz]) * 100.0, abs=10.0)
    for f in fixes:
        assert f.vel == pytest.approx(math.hypot(f.vn, f.ve), abs=1.5)
        course = math.degrees(math.atan2(f.ve, f.vn)) % 360.0
        assert f.cog == 65535 or math.remainder(f.cog / 100.0 - course, 360.0) == pytest.approx(0.0, abs=3.0)
        assert f.fix_type >= 3
        assert f.satellites_visible >= 6  # PX4's default of EKF2_REQ_NSATS is 6


def test_rates_of_the_sensors_and_the_flags_of_what_is_new():
    readings, fixes = many(body(), 250)  # messages of one second
    flags = [m.fields_updated for m in readings]
    assert flags.count(0b1101111111111) == 50  # all sensors except differential pressure
    assert flags.count(0b111111) == 200
    assert flags[0] == 0b1101111111111
    assert [m.time_usec for m in readings] == list(range(0, 1_000_000, 4000))
    assert [m.time_usec for m in fixes] == list(range(96_000, 1_000_000, 100_000))


SOUND = OdometryLink(100.0)
STEP_NS = 4_000_000


def posed(position=(1.0, 2.0, 3.0), q=(1.0, 0.0, 0.0, 0.0)):
    return Body(position, (0.0, 0.0, 0.0), q, (0.0, 0.0, 0.0))


def poses(link, state, count=2500, seed=1):
    """Return arrival time, ms, and pose of all samples that arrive within ``count`` steps."""
    mocap = Px4Mocap(link, seed)
    return [(4 * k, m) for k in range(count) for m in mocap.poll(state, k * STEP_NS, 1_000_000 + 4000 * k)]


def test_comes_at_50_hz_at_most_and_at_a_lower_rate_if_the_scenario_has_one():
    assert len(poses(SOUND, posed(), 250)) == 50
    assert len(poses(OdometryLink(30.0), posed(), 250)) == 30
    assert [ms for ms, _ in poses(SOUND, posed(), 12)] == [0, 20, 40]


def test_comes_after_the_delay_with_the_pose_of_before():
    mocap = Px4Mocap(OdometryLink(50.0, delay_s=0.012), 1)
    found = []
    for k in range(10):
        found += [(k, m) for m in mocap.poll(posed((0.1 * k, 0.0, 0.0)), k * STEP_NS, 4000 * k)]
    assert [(k, round(m.y, 3)) for k, m in found] == [(3, 0.0), (8, 0.5)]
    assert [m.time_usec for _, m in found] == [12000, 32000]


@examples(50)
@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3), st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_shows_the_pose_of_frd_in_ned(position, raw):
    assume(math.hypot(*raw) > 0.1)
    q = np.array(raw) / math.hypot(*raw)
    _, m = poses(SOUND, posed(position, tuple(q)), 1)[0]
    assert (m.x, m.y, m.z) == pytest.approx((position[1], position[0], -position[2]))
    assert rotation(m.q) == pytest.approx(NED_OF_ENU @ rotation(q) @ FRD, abs=1e-6)
    assert (m.frame_id, m.child_frame_id, m.estimator_type) == (1, 12, 2)  # NED frame, body frame FRD, vision
    assert math.isnan(m.vx)
    assert math.isnan(m.rollspeed)


def test_noise_and_losses_are_the_scenario_s_and_the_variances_say_so():
    link = OdometryLink(50.0, position_noise_m=0.01, yaw_noise_rad=0.05, loss=0.2)
    found = [m for _, m in poses(link, posed(), 12_500)]
    assert len(found) == pytest.approx(0.8 * 2500, rel=0.05)
    assert np.std([(m.x, m.y, m.z) for m in found], axis=0) == pytest.approx([0.01] * 3, rel=0.1)
    yaw = [2.0 * math.atan2(m.q[3], m.q[0]) - math.pi / 2 for m in found]
    assert np.std([math.remainder(y, math.tau) for y in yaw]) == pytest.approx(0.05, rel=0.1)
    variances = [found[0].pose_covariance[i] for i in (0, 6, 11, 15, 18, 20)]
    assert variances == pytest.approx([1e-4] * 3 + [2.5e-3] * 3)
