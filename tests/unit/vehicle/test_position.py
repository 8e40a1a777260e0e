"""Tests position set-points, which the PID cascade follows."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.compiled.records import new
from sim.firmware.pid import TILT_MAX_DEG, CascadeRecord, cascade_update, set_up_cascade
from sim.firmware.setpoint import SensedState, SetpointRecord, set_point
from sim.plant.params import load
from sim.scenarios.tables import Start, StartKind, VehicleSpec, VelocityLoop
from tests.unit.vehicle.vehicle_sim_helpers import vehicle

PARAMS = load()


def sensed_at(position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), yaw=0.0):
    sensed = new(SensedState)
    cos, sin = math.cos(yaw), math.sin(yaw)
    sensed.axes = (cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0)
    sensed.position, sensed.velocity = position, velocity
    return sensed


def record(setpoint):
    return new(SetpointRecord, setpoint)


def cascade():
    loop = new(CascadeRecord)
    set_up_cascade(loop, PARAMS)
    return loop


def pid(loop, sensed, setpoint, level=False):
    thrust, moments = cascade_update(loop, sensed, record(setpoint), level)
    return thrust, moments, float(loop.pitch_wanted), float(loop.roll_wanted)


class TestPidPosition:
    @given(
        st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.floats(-3.0, 3.0)
    )
    def test_the_first_tick_by_hand(self, error, velocity, yaw):
        """The tilt is (kp + ki dt) (2 e - v) in the yawed frame; e is the position error, v the velocity.

        The thrust has the same form, with the integral of the height error added to 2 e.
        """
        loop = cascade()
        at = (1.0, -2.0, 0.5)
        wanted = tuple(a + e for a, e in zip(at, error, strict=True))
        thrust, _, pitch, roll = pid(
            loop, sensed_at(at, velocity, yaw), set_point(position=wanted, yaw_rad=yaw)
        )
        asked = [2.0 * e - v for e, v in zip(error[:2], velocity[:2], strict=True)]
        ahead = math.cos(yaw) * asked[0] + math.sin(yaw) * asked[1]
        aside = math.cos(yaw) * asked[1] - math.sin(yaw) * asked[0]
        limit = TILT_MAX_DEG
        assert pitch == pytest.approx(np.clip((25.0 + 0.01) * ahead, -limit, limit), abs=1e-9)
        assert roll == pytest.approx(np.clip(-(25.0 + 0.01) * aside, -limit, limit), abs=1e-9)
        up = (2.0 + 0.5 * 0.01) * error[2] - velocity[2]
        assert thrust == pytest.approx(36000.0 + 1000.0 * (25.0 + 15.0 * 0.01) * up, abs=1e-6)

    def test_the_speed_is_limited_before_the_tilt(self):
        _, _, pitch, _ = pid(
            cascade(), sensed_at(velocity=(1.0, 0.0, 0.0)), set_point(position=(9.0, 0.0, 0.0))
        )
        assert pitch == pytest.approx(25.01 * (1.1 - 1.0))

    def test_another_kind_of_set_point_resets_the_integrals(self):
        loop = cascade()
        for _ in range(50):
            pid(loop, sensed_at(), set_point(position=(0.0, 0.0, 0.1)))
        assert loop.z.integral == pytest.approx(10 * 0.01 * 0.1)
        assert loop.vz.integral > 0.0
        pid(loop, sensed_at(), set_point())
        assert (loop.z.integral, loop.vz.integral) == (0.0, 0.0)


RAMP_M_S = 0.5


def test_a_moving_set_point_is_followed_half_a_second_late():
    """With position set-points only, the vehicle is 1 / kp = 0.5 s late, plus a small effect of drag."""
    sim = vehicle(
        start=Start(StartKind.GROUND, ground_position_m=(3.0, 0.0)),
        vehicle=VehicleSpec("crazyflie21_room", VelocityLoop.PID),
    )
    sim.advance(100)
    assert sim.arm() is None
    x0, y0, _ = sim.body().position_enu_m
    lags = []
    for tick in range(600):
        x = RAMP_M_S * max(0.0, tick - 400) / 100.0
        sim.set_position((x0 + x, y0, 1.0), 0.0)
        sim.advance(10)
        lags.append(x0 + x - sim.body().position_enu_m[0])
    assert sim.body().position_enu_m[2] == pytest.approx(1.0, abs=0.2)
    assert sim.body().position_enu_m[1] == pytest.approx(y0, abs=0.05)
    assert np.mean(lags[-60:]) / RAMP_M_S == pytest.approx(0.5, abs=0.08)
