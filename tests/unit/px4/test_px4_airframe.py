"""PX4's parameters for our vehicles, against formulas and numbers written down anew."""

import math

import numpy as np
import pytest

from bridge.mavlink.preflight.rules import RULES, Needs
from bridge.mocap.vehicle import WANTS
from sim.plant.params import load
from sim.plant.rotors import MIX_YAW
from sim.px4.airframe import FORMATS, parameter_text, parameters, rotor_speeds
from sim.scenarios.scenario import Airframe, OdometryLink
from tests.unit.px4.px4_fakes import QUAD_X, controlled_axes, parameters_of

FRAMES = list(Airframe)


@pytest.mark.parametrize("airframe", FRAMES)
def test_geometry_is_px4_s_quad_x_with_the_arm_of_the_vehicle(airframe):
    params = load(airframe)
    found = parameters(params)
    for i, (x, y, spin) in enumerate(QUAD_X):
        assert found[f"CA_ROTOR{i}_PX"] == pytest.approx(x * params.rotor.arm_m, abs=1e-5)
        assert found[f"CA_ROTOR{i}_PY"] == pytest.approx(y * params.rotor.arm_m, abs=1e-5)
        assert math.copysign(1.0, found[f"CA_ROTOR{i}_KM"]) == spin
        assert found[f"PWM_MAIN_FUNC{i + 1}"] == 101 + i


@pytest.mark.parametrize(("airframe", "hover", "ratio"), [
    (Airframe.CRAZYFLIE20, 0.0319 * 9.81 / 0.48, 0.00705), (Airframe.QUAD_1000G, 0.4905, 0.02),
])  # fmt: skip
def test_hover_thrust_and_torque_ratio_are_those_of_the_vehicle(airframe, hover, ratio):
    params = load(airframe)
    found = parameters(params)
    assert found["MPC_THR_HOVER"] == pytest.approx(hover, abs=1e-4)
    assert found["CA_ROTOR0_KM"] == pytest.approx(ratio, abs=1e-4)
    speeds = rotor_speeds([hover] * 4, True, params.rotor)
    assert sum(params.rotor.thrust_n(s) for s in speeds) == pytest.approx(
        params.body.mass_kg * params.contact.gravity_m_s2
    )
    rotor = params.rotor
    torque = (rotor.torque_linear_n_m_rpm + rotor.torque_square_n_m_rpm2 * speeds[0]) * speeds[0]
    assert torque / rotor.thrust_n(speeds[0]) == pytest.approx(found["CA_ROTOR0_KM"], abs=1e-4)
    assert MIX_YAW[0] == -1


@pytest.mark.parametrize("airframe", FRAMES)
def test_px4_controls_every_axis_and_would_not_with_its_own_thrust_coefficient_on_a_crazyflie(airframe):
    found = parameters(load(airframe))
    assert list(controlled_axes(found)) == [1.0, 1.0, 1.0]
    without = {name: value for name, value in found.items() if not name.endswith("_CT")}
    yaw = 0.0 if airframe is Airframe.CRAZYFLIE20 else 1.0
    assert list(controlled_axes(without)) == [1.0, 1.0, yaw]


@pytest.mark.parametrize("airframe", FRAMES)
@pytest.mark.parametrize(("axis", "index"), [("ROLL", 0), ("PITCH", 1)])
def test_the_rate_loop_is_fast_enough_and_damped(airframe, axis, index):
    params = load(airframe)
    found = parameters(params)
    per_command = 2.0 * math.sqrt(2.0) * params.rotor.thrust_max_n * params.rotor.arm_m
    per_command /= params.body.inertia_kg_m2[index]
    p, i, d = (found[f"MC_{axis}RATE_{term}"] for term in "PID")
    lag, attitude = params.rotor.lag_s, found[f"MC_{axis}_P"]
    # rate' = per_command u / (lag s + 1), u = (p + i/s) (attitude e - rate) - d rate', e' = -rate
    poles = np.roots(
        [
            lag,
            1.0 + d * per_command,
            p * per_command,
            (i + p * attitude) * per_command,
            i * attitude * per_command,
        ]
    )
    assert max(poles.real) < -1.0
    oscillating = [s for s in poles if s.imag > 0.0]
    assert all(-s.real / abs(s) > 0.4 for s in oscillating)
    assert 0.01 <= p <= 0.5  # limits that PX4 states for them
    assert 0.0 <= d <= 0.01


@pytest.mark.parametrize("airframe", FRAMES)
@pytest.mark.parametrize("form", FORMATS)
def test_the_lines_of_every_form_hold_all_of_them(airframe, form):
    params = load(airframe)
    text = parameter_text(params, form)
    assert parameters_of(text) == pytest.approx(parameters(params))
    assert "CA_ROTOR_COUNT=4" in text or "CA_ROTOR_COUNT 4\n" in text  # whole numbers stay whole
    assert all(len(name) <= 16 for name in parameters(params))  # MAVLink's limit


def test_the_check_before_a_flight_finds_nothing_unsafe_in_them():
    found, needs = parameters(load()), Needs((0.5, 0.5, 0.5), 3.0, 0.5, (2.0, 2.0, 2.5))
    checked = [rule for rule in RULES["px4"] if rule.name in found]
    assert {rule.name for rule in checked} == {"COM_OBL_RC_ACT", "COM_RC_IN_MODE", "SYS_FAILURE_EN"}
    assert all(rule.safe(found[rule.name], needs) for rule in checked)


def test_motion_capture_takes_the_place_of_satellites():
    link = OdometryLink(100.0, delay_s=0.015)
    found = parameters(load(), link)
    assert "EKF2_GPS_P_NOISE" not in found
    assert found["EKF2_EV_DELAY"] == 15.0
    settings = dict(pair.rsplit(" ", 1) for pair in WANTS[12].settings.split(", "))  # of the bridge's page
    assert {name: found[name] for name in settings} == {name: int(value) for name, value in settings.items()}
