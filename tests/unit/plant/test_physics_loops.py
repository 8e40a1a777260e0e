"""Closed loops: simulated small steps against the poles of a linear model derived on its own."""

import math

import numpy as np
import pytest

from sim.compiled.rotation import nine
from sim.firmware.attitude import attitude_moments
from sim.firmware.mixer import mix, motor_speed
from sim.firmware.paper_loop import axes_from_force
from sim.vehicle.loop import sense
from tests import linear_analysis as linear
from tests.unit.plant.physics_helpers import FreePlant, quiet_vehicle

NOMINAL_S = 0.07
HOVER_COUNTS = linear.MASS * linear.G / 4.0 / linear.N_PER_COUNT
STEP_DEG = 1.0


def lag_of(slow):
    return linear.slow_lag_s() if slow else NOMINAL_S


def attitude_step(axis, slow, seconds):
    """Roll, pitch or yaw after a step of the desired attitude in hover, in parts of the step, 500 Hz."""
    plant = FreePlant(slow)
    plant.no_drag()
    plant.rotors(linear.HOVER_RPM)
    plant.sim._settle()
    f, size = plant.record.firmware, math.radians(STEP_DEG)
    force = [(0.0, -math.tan(size), 1.0), (math.tan(size), 0.0, 1.0), (0.0, 0.0, 1.0)][axis]
    yaw = size if axis == 2 else 0.0
    desired = axes_from_force(*force, math.cos(yaw), math.sin(yaw))
    f.paper.attitude.wx = math.nan
    out = []
    for k in range(round(seconds * 500)):
        if k % 100 == 0:
            plant.sim._imu.top_up()
        sense(plant.sim._vehicle)
        s = f.estimator.sensed
        moments = attitude_moments(
            f.paper.attitude, nine(s.axes), desired, s.rates[0], s.rates[1], s.rates[2]
        )
        counts = mix(HOVER_COUNTS, moments)
        plant.run(2, [motor_speed(f.thrust_map, c, 1e9) for c in counts])
        w, x, y, z = plant.state[6:10]
        angle = (2.0 * w * x, 2.0 * w * y, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
        out.append(angle[axis] / size)
    return np.array(out)


def slowest(poles, count):
    """The poles that last, without integrators that the output does not show."""
    return np.array([p for p in poles if p.real < -0.3][:count])


def nearest(pole, candidates):
    return min(np.abs(np.asarray(candidates) - pole))


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("axis", [0, 1])
def test_roll_and_pitch_steps_have_the_linear_models_poles(axis, slow):
    y = attitude_step(axis, slow, 1.5)
    assert y[-1] == pytest.approx(1.0, abs=0.01)
    loop = linear.roll_loop(lag_of(slow))
    assert np.abs(y - loop.response(1.5)).max() < 0.01
    measured = linear.prony_poles(y, linear.DT, 3)
    for pole in slowest(loop.poles(), 3):
        assert nearest(pole, measured) < 0.1 * abs(pole)


@pytest.mark.parametrize("slow", [False, True])
def test_yaw_step_has_the_linear_models_poles(slow):
    y = attitude_step(2, slow, 5.0)
    loop = linear.yaw_loop(lag_of(slow))
    expected = loop.response(5.0)
    assert np.abs(y - expected).max() < 0.015
    measured = linear.prony_poles(y, linear.DT, 4)  # the integral's slow pole and the motor's among them
    for pole in slowest(loop.poles(), 2):
        assert nearest(pole, measured) < 0.1 * abs(pole)
    without = linear.yaw_loop(lag_of(slow), reaction=False).response(5.0)
    assert np.abs(y - without).max() > 3.0 * np.abs(y - expected).max()  # the reaction torque shows


def velocity_step(axis, slow, seconds):
    """Velocity along an axis after a small step of the set-point, in parts of the step, 500 Hz."""
    sim = quiet_vehicle(slow)
    size = 0.02
    sim.set_velocity((0.0, 0.0, 0.0), 0.0)
    sim.advance(500)
    before = np.array(sim.truth().velocity_enu_m_s)
    wanted = [0.0, 0.0, 0.0]
    wanted[axis] = size
    out = []
    for k in range(round(seconds * 500)):
        if k % 50 == 0:
            sim.set_velocity(tuple(wanted), 0.0)
        sim.advance(2)
        out.append((sim.truth().velocity_enu_m_s[axis] - before[axis]) / size)
    return np.array(out)


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_velocity_steps_of_the_papers_loop(axis, slow):
    """Whole vehicle, K_v = 0.5: estimator, attitude loop, motors and all."""
    y = velocity_step(axis, slow, 3.0)
    if axis == 2:  # thrust of all four rises together, with the rate of rising
        lag = 1.0 / linear.PARAMS.rotor.slow_rise_1_s if slow else NOMINAL_S
        loop = linear.vertical_loop(lag)
    else:
        loop = linear.horizontal_loop(lag_of(slow))
    expected = loop.response(3.0)
    asymmetric = slow and axis == 2  # the linear model rises only, the slow motors also fall, faster
    assert np.abs(y - expected).max() < (0.12 if asymmetric else 0.015)
    assert y.max() == pytest.approx(expected.max(), rel=0.1)  # the overshoot
    assert y.argmax() == pytest.approx(expected.argmax(), rel=0.1)


def test_horizontal_loop_is_under_damped_as_the_paper_chose():
    dominant = [p for p in linear.horizontal_loop(NOMINAL_S).poles() if 8.0 < abs(p) < 15.0]
    assert len(dominant) == 2
    assert -dominant[0].real / abs(dominant[0]) == pytest.approx(0.29, abs=0.03)
    response = linear.horizontal_loop(NOMINAL_S).response(3.0)
    assert response.max() > 1.2


@pytest.mark.parametrize(
    ("lag", "real", "cubic"), [(0.05, -7.9, -7.888), (0.07, -7.8, -7.804), (0.136, -7.6, -7.560)]
)
def test_roll_poles_agree_with_the_characteristic_polynomial(lag, real, cubic):
    """Without sampling and gyro filter: tau J s^3 + (J + k_d) s^2 + k_w s + 2 k_R = 0."""
    u, j = linear.TORQUE_PER_COUNT, 16.8e-6
    roots = np.roots([lag * j, j + 200.0 * u, 2e4 * u, 1.4e5 * u])
    slow = max(r.real for r in roots if abs(r.imag) < 1e-9)
    assert slow == pytest.approx(cubic, abs=1e-3)
    sampled = [p.real for p in linear.roll_loop_poles(lag) if abs(p.imag) < 1e-9 and -20.0 < p.real < -1.0]
    assert sampled == pytest.approx([real], rel=0.02)  # both delays are short against this pole


def test_default_yaw_gains_need_the_reaction_torque(monkeypatch):
    """With kR_z = 6e4, kw_z = 1.2e4 and slow motors the loop would be unstable without it."""
    monkeypatch.setattr(linear.att, "K_R_Z", 6e4)
    monkeypatch.setattr(linear.att, "K_W_Z", 1.2e4)
    assert linear.yaw_loop(0.136, reaction=True).poles().real.max() < 1e-9
    assert linear.yaw_loop(0.136, reaction=False).poles().real.max() > 0.3


@pytest.mark.parametrize(("wn", "zeta"), [(10.0, 0.3), (4.0, 0.7), (20.0, 1.45)])
def test_the_fit_finds_a_second_order_response(wn, zeta):
    t = np.arange(0.0, 40.0 / (min(zeta, 1 / zeta) * wn), 0.002)
    root = np.sqrt(complex(zeta**2 - 1.0))
    p, q = -wn * (zeta - root), -wn * (zeta + root)
    y = (
        1.0 - (q * np.exp(p * t) - p * np.exp(q * t)).real / (q - p).real
        if zeta > 1
        else (1.0 - ((q * np.exp(p * t) - p * np.exp(q * t)) / (q - p)).real)
    )
    assert linear.fit_second_order(t, y) == pytest.approx((wn, zeta), rel=1e-3)
