"""Tests position set-points: PID position loop, Mellinger controller, map of thrust counts to volts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.compiled.records import new
from sim.firmware.geometric import MASS_KG, MASS_THRUST, MellingerLoop, mellinger_update
from sim.firmware.pid import TILT_MAX_DEG, PidLoop, cascade_update
from sim.firmware.setpoint import SensedState, Setpoint, SetpointRecord
from sim.plant.params import load
from sim.scenarios.tables import Start, StartKind, VehicleSpec, VelocityLoop
from tests.unit.vehicle.vehicle_sim_helpers import vehicle

PARAMS = load()
WEIGHT = MASS_KG * 9.81


def sensed_at(position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), yaw=0.0):
    sensed = new(SensedState)
    cos, sin = math.cos(yaw), math.sin(yaw)
    sensed.axes = (cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0)
    sensed.position, sensed.velocity = position, velocity
    return sensed


def record(setpoint):
    return new(SetpointRecord, setpoint.fields())


def pid(loop, sensed, setpoint, level=False):
    thrust, moments = cascade_update(loop.record, sensed, record(setpoint), level)
    return thrust, moments, float(loop.record.pitch_wanted), float(loop.record.roll_wanted)


class TestPidPosition:
    @given(
        st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.tuples(*[st.floats(-0.2, 0.2)] * 3), st.floats(-3.0, 3.0)
    )
    def test_the_first_tick_by_hand(self, error, velocity, yaw):
        """Tilt = (kp + ki dt) (2 e - v) in the yawed frame; thrust likewise, with the integral of 2 e."""
        loop = PidLoop(PARAMS)
        at = (1.0, -2.0, 0.5)
        wanted = tuple(a + e for a, e in zip(at, error, strict=True))
        thrust, _, pitch, roll = pid(
            loop, sensed_at(at, velocity, yaw), Setpoint(position=wanted, yaw_rad=yaw)
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
            PidLoop(PARAMS), sensed_at(velocity=(1.0, 0.0, 0.0)), Setpoint(position=(9.0, 0.0, 0.0))
        )
        assert pitch == pytest.approx(25.01 * (1.1 - 1.0))

    def test_another_kind_of_set_point_resets_the_integrals(self):
        loop = PidLoop(PARAMS)
        for _ in range(50):
            pid(loop, sensed_at(), Setpoint(position=(0.0, 0.0, 0.1)))
        assert loop.record.z.integral == pytest.approx(10 * 0.01 * 0.1)
        assert loop.record.vz.integral > 0.0
        pid(loop, sensed_at(), Setpoint())
        assert (loop.record.z.integral, loop.record.vz.integral) == (0.0, 0.0)


def mellinger(loop, sensed, setpoint, level=False):
    return mellinger_update(loop.record, sensed, record(setpoint), level)


class TestMellinger:
    @given(st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.tuples(*[st.floats(-0.3, 0.3)] * 3))
    def test_the_first_tick_by_hand(self, error, velocity):
        """The gains give the force; for a level body its upward part is all thrust."""
        counts, (mx, my, mz) = mellinger(
            MellingerLoop(), sensed_at(velocity=velocity), Setpoint(position=error)
        )
        step = 0.002
        fx, fy = (0.4 * e - 0.2 * v + 0.05 * step * e for e, v in zip(error[:2], velocity[:2], strict=True))
        fz = WEIGHT + 1.25 * error[2] - 0.4 * velocity[2] + 0.05 * step * error[2]
        if fz <= 0.0:
            assert (counts, mx, my, mz) == (0.0, 0, 0, 0)
            return
        assert counts == pytest.approx(fz * MASS_THRUST)
        z = np.array([fx, fy, fz]) / math.sqrt(fx * fx + fy * fy + fz * fz)
        y = np.cross(z, (1.0, 0.0, 0.0))
        y /= np.linalg.norm(y)
        x = np.cross(y, z)
        e_r = (z[1] - y[2], x[2] - z[0], y[0] - x[1])  # attitude error: vector of Rd' R - R' Rd at R = 1
        expected = [
            np.clip(-gain * e, -32000.0, 32000.0) for gain, e in zip((7e4, 7e4, 6e4), e_r, strict=True)
        ]
        assert (mx, my, mz) == pytest.approx(expected, abs=1.5)

    def test_the_velocity_is_fed_forward(self):
        loop, moving = MellingerLoop(), (0.3, 0.2, -0.1)
        counts, moments = mellinger(
            loop, sensed_at(velocity=moving), Setpoint(*moving, position=(0.0, 0.0, 0.0))
        )
        assert counts == pytest.approx(WEIGHT * MASS_THRUST)
        assert moments == (0, 0, 0)

    def test_the_integral_of_the_height_is_bounded(self):
        """A vehicle heavier than its nominal mass stays below its set-point, as in recorded flights."""
        loop = MellingerLoop()
        for _ in range(5000):
            counts, _ = mellinger(loop, sensed_at(), Setpoint(position=(0.0, 0.0, 0.1)))
        assert counts == pytest.approx((WEIGHT + 1.25 * 0.1 + 0.05 * 0.4) * MASS_THRUST)


RAMP_M_S = 0.5


@pytest.mark.parametrize("by_mellinger", [False, True])
def test_a_moving_set_point_is_followed_half_a_second_late(by_mellinger):
    """Without velocity set-points the lags are 1 / kp and kd / kp, plus drag, minus Mellinger's integral."""
    sim = vehicle(
        start=Start(StartKind.GROUND, ground_position_m=(3.0, 0.0)),
        vehicle=VehicleSpec("crazyflie21_room", VelocityLoop.PID),
    )
    if by_mellinger:
        sim.choose_mellinger()
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
