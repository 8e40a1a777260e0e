"""Tests the simulated vehicle that PX4 flies: parameters, motors and physics."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.mavlink.preflight.table import Needs, table
from bridge.mavlink.profiles import PX4
from flightstack.common.strict_toml import ConfigError
from sim.firmware.mixer import OFF
from sim.plant.params import load
from sim.plant.rotors import MIX_YAW
from sim.px4.airframe import FORMATS, parameter_text, parameters, rotor_speeds
from sim.px4.plant import Px4Plant
from sim.scenarios.scenario import load as load_scenario
from sim.scenarios.tables import VEHICLE_FILES, OdometryLink, Start, StartKind, Wind
from sim.vehicle.vehicle import VehicleSim
from tests.unit.px4.px4_fakes import QUAD_X, controlled_axes, parameters_of
from tests.unit.vehicle.vehicle_sim_helpers import scenario

ROTOR = load().rotor
GROUND = Start(StartKind.GROUND, ground_position_m=(-1.0, 0.4))
HOVER = 0.0319 * 9.81 / 0.48


def flying(seed=1, **parts):
    """Return a vehicle that has climbed for 1.2 s with equal rotor speeds."""
    plant = Px4Plant(scenario(GROUND, **parts), seed)
    plant.wanted[:] = rotor_speeds([1.1 * HOVER] * 4, True, ROTOR)
    plant.advance(1200)
    assert plant.body().position_enu_m[2] > 0.3
    return plant


def test_equals_the_vehicle_of_the_simulator_bit_by_bit_when_it_gets_the_same_rotor_speeds():
    windy = {"wind": Wind(mean_m_s=0.5, gust_rms_m_s=0.3)}
    vehicle, plant = VehicleSim(scenario(GROUND, **windy), 4), Px4Plant(scenario(GROUND, **windy), 4)
    assert vehicle.arm() is None
    for tick in range(1500):
        if tick % 20 == 0:
            vehicle.set_velocity((0.2, -0.1, 0.3), 0.0)
        vehicle.advance(2)
        plant.wanted[:] = vehicle.record.firmware.commands
        plant.advance(2)
        assert plant.body().position_enu_m == vehicle.body().position_enu_m, tick
    theirs, ours = vehicle.truth(), plant.truth()
    assert ours.position_enu_m[2] > 0.5
    assert ours.orientation == theirs.orientation
    assert ours.rotor_rpm == theirs.rotor_rpm
    assert ours.battery_v == theirs.battery_v
    assert ours.wind_enu_m_s == theirs.wind_enu_m_s
    assert (ours.h_m, ours.h_min_m, ours.contacts) == (theirs.h_m, theirs.h_min_m, theirs.contacts)


@pytest.mark.parametrize(
    ("more", "axis", "sign"),
    [
        ((1, 2), 0, +1),  # both left motors: the right side moves down
        ((0, 3), 0, -1),
        ((0, 2), 1, -1),  # both front motors: the nose moves up, a negative rotation about the left axis
        ((1, 3), 1, +1),
        ((0, 1), 2, -1),  # both counter-clockwise motors: the body turns clockwise
        ((2, 3), 2, +1),
    ],
)
def test_more_on_two_motors_turns_the_vehicle_to_the_right_side(more, axis, sign):
    plant = flying()
    controls = [HOVER + (0.02 if i in more else -0.02) for i in range(4)]
    plant.wanted[:] = rotor_speeds(controls, True, ROTOR)
    plant.advance(100)
    rates = plant.body().angular_velocity_flu_rad_s
    assert sign * rates[axis] > 0.1
    assert max(abs(rates[i]) for i in range(3) if i != axis) < 0.2 * abs(rates[axis])


@given(st.lists(st.floats(), min_size=4, max_size=16))
def test_whatever_comes_the_speeds_are_numbers_within_bounds(controls):
    speeds = rotor_speeds(controls, True, ROTOR)
    assert all(0.0 <= s <= ROTOR.rpm(ROTOR.thrust_max_n) for s in speeds)
    assert rotor_speeds(controls, False, ROTOR) == OFF


@pytest.mark.parametrize("off", [math.nan, math.inf, -math.inf, -0.5, 0.0, 0.05])
def test_a_motor_without_a_sound_output_stands_still(off):
    assert rotor_speeds([off] * 4, True, ROTOR) == OFF
    assert rotor_speeds([0.5, off, 0.5, 0.5], True, ROTOR)[2] == 0.0  # PX4's second motor is M3


@pytest.mark.parametrize(("name", "word"), [("fault_motor_dead", "fault"), ("field", "offset_m")])
def test_scenarios_that_px4_cannot_fly_are_refused_with_a_reason(name, word):
    with pytest.raises(ConfigError, match=word):
        Px4Plant(load_scenario(name), 1)


FRAMES = VEHICLE_FILES.names()


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
    ("crazyflie20", 0.0319 * 9.81 / 0.48, 0.00705), ("quad_1000g", 0.4905, 0.02),
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
    yaw = 0.0 if airframe.startswith("crazyflie") else 1.0
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
    assert 0.01 <= p <= 0.5  # the range that PX4 documents
    assert 0.0 <= d <= 0.01


@pytest.mark.parametrize("airframe", FRAMES)
@pytest.mark.parametrize("form", FORMATS)
def test_the_lines_of_every_form_hold_all_of_them(airframe, form):
    params = load(airframe)
    text = parameter_text(params, form)
    assert parameters_of(text) == pytest.approx(parameters(params))
    assert "CA_ROTOR_COUNT=4" in text or "CA_ROTOR_COUNT 4\n" in text  # integers are printed without decimals
    assert all(len(name) <= 16 for name in parameters(params))  # the maximum length of a name in MAVLink


def test_the_check_before_a_flight_finds_nothing_unsafe_in_them():
    found, needs = parameters(load()), Needs(0.7, 0.5, 2.8, 2.5, 3.0)
    for release in table("px4").releases:
        checked = [each for each in table("px4").asked("px4", release) if each.name.name in found]
        assert {each.name.name for each in checked} == {"COM_OBL_RC_ACT", "COM_RC_IN_MODE", "SYS_FAILURE_EN"}
        assert all(rule.safe(found[name.name], needs) for name, rule, _ in checked)


def test_motion_capture_takes_the_place_of_satellites():
    link = OdometryLink(100.0, delay_s=0.015)
    found = parameters(load(), link)
    assert "EKF2_GPS_P_NOISE" not in found
    assert found["EKF2_EV_DELAY"] == 15.0
    settings = dict(pair.rsplit(" ", 1) for pair in PX4.pose_settings.split(", "))
    assert {name: found[name] for name in settings} == {name: int(value) for name, value in settings.items()}
