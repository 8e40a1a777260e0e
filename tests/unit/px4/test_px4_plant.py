"""Vehicle without firmware, and PX4's motor outputs on it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.common.strict_toml import ConfigError
from sim.plant.params import load
from sim.plant.rotors import MIX_YAW, POSITION_X, POSITION_Y
from sim.px4.airframe import OFF, PX4_OF_M, rotor_speeds
from sim.px4.plant import Px4Plant
from sim.scenarios.scenario import Airframe, Start, StartKind, Wind
from sim.scenarios.scenario import load as load_scenario
from sim.vehicle.vehicle import VehicleSim
from tests.unit.vehicle.vehicle_sim_helpers import scenario

ROTOR = load().rotor
GROUND = Start(StartKind.GROUND, ground_position_m=(-1.0, 0.4))
HOVER = 0.0319 * 9.81 / 0.48


def flying(seed=1, **parts):
    """A vehicle that has climbed for a while with equal outputs."""
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
        plant.wanted[:] = vehicle._firmware.commands
        plant.advance(2)
        assert plant.body().position_enu_m == vehicle._physics.body()[:3], tick
    theirs, ours = vehicle.truth(), plant.truth()
    assert ours.position_enu_m[2] > 0.5
    assert ours.quaternion == theirs.quaternion
    assert ours.rotor_rpm == theirs.rotor_rpm
    assert ours.battery_v == theirs.battery_v
    assert ours.wind_enu_m_s == theirs.wind_enu_m_s
    assert (ours.h_m, ours.h_min_m, ours.contacts) == (theirs.h_m, theirs.h_min_m, theirs.contacts)


def test_outputs_drive_the_motors_that_px4_means():
    # PX4: front right and rear left counter-clockwise, then front left and rear right clockwise
    forward, right, turns = (1, -1, 1, -1), (1, -1, -1, 1), (1, 1, -1, -1)
    for ours, px4 in enumerate(PX4_OF_M):
        assert POSITION_X[ours] == forward[px4]
        assert -POSITION_Y[ours] == right[px4]
        assert -MIX_YAW[ours] == turns[px4]
    assert sorted(PX4_OF_M) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("more", "axis", "sign"),
    [
        ((1, 2), 0, +1),  # both on the left: right side down
        ((0, 3), 0, -1),
        ((0, 2), 1, -1),  # both in front: nose up, negative about the axis to the left
        ((1, 3), 1, +1),
        ((0, 1), 2, -1),  # both counter-clockwise ones: the body turns clockwise
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


def test_the_share_that_carries_the_weight_holds_the_height():
    plant = flying()
    up = plant.body().velocity_enu_m_s[2]
    plant.wanted[:] = rotor_speeds([HOVER] * 4, True, ROTOR)
    plant.advance(3000)
    # what is left of the climb, slowed by drag with a time constant of 2.5 s
    assert 0.0 < plant.body().velocity_enu_m_s[2] < 0.5 * up


@given(st.lists(st.floats(0.11, 1.0), min_size=4, max_size=4))
def test_thrust_is_a_linear_share_of_the_highest_thrust(controls):
    speeds = rotor_speeds(controls, True, ROTOR)
    for ours, px4 in enumerate(PX4_OF_M):
        assert ROTOR.thrust_n(speeds[ours]) == pytest.approx(controls[px4] * ROTOR.thrust_max_n, rel=1e-9)


@given(st.lists(st.floats(), min_size=4, max_size=16))
def test_whatever_comes_the_speeds_are_numbers_within_bounds(controls):
    speeds = rotor_speeds(controls, True, ROTOR)
    assert all(0.0 <= s <= ROTOR.rpm(ROTOR.thrust_max_n) for s in speeds)
    assert rotor_speeds(controls, False, ROTOR) == OFF


@pytest.mark.parametrize("off", [math.nan, math.inf, -math.inf, -0.5, 0.0, 0.05])
def test_a_motor_without_a_sound_output_stands_still(off):
    assert rotor_speeds([off] * 4, True, ROTOR) == OFF
    assert rotor_speeds([0.5, off, 0.5, 0.5], True, ROTOR)[2] == 0.0  # PX4's second is M3


def test_battery_limits_the_speed():
    plant = Px4Plant(scenario(GROUND), 1)
    plant.wanted[:] = 1e6
    plant.advance(1000)
    assert max(plant.rotor_rpm) < 1.02 * (2968.2 + 6647.9 * 4.15)


def test_stands_still_until_the_motors_turn_on_floor_and_first_judged_in_the_air():
    plant = Px4Plant(scenario(GROUND), 1)
    plant.advance(1000)
    truth = plant.truth()
    assert truth.position_enu_m == pytest.approx((-1.0, 0.4, 0.0144), abs=1e-3)
    assert np.linalg.norm(truth.velocity_enu_m_s) < 1e-3
    assert plant.on_ground
    assert not plant.on_pad
    assert not truth.motors_running
    assert math.isnan(truth.first_touch_time_s)


def test_the_deck_carries_what_landed_on_it():
    plant = Px4Plant(scenario(Start(StartKind.HOVER, offset_m=(0.5, 0.0, 1.0))), 1)
    pad = plant.truth().pad_position_enu_m
    plant._physics.judge_from_here()
    plant._world.set_vehicle((pad[0], pad[1], pad[2] + 0.05))
    plant.advance(600)
    truth = plant.truth()
    assert plant.on_pad
    assert 0.0 < truth.first_touch_time_s < 0.2
    plant.set_deck(pad, 0.0, (0.2, 0.1, 0.0), 0.0)
    plant.advance(1000)
    body = plant.body()
    assert body.velocity_enu_m_s == pytest.approx((0.2, 0.1, 0.0), abs=0.01)
    assert plant.truth().pad_position_enu_m == pytest.approx((pad[0] + 0.2, pad[1] + 0.1, pad[2]), abs=1e-6)


def test_a_hover_start_becomes_one_on_the_floor_below():
    plant = Px4Plant(load_scenario("large"), 1)
    assert load_scenario("large").vehicle.airframe is Airframe.QUAD_1000G
    assert plant.body().position_enu_m == pytest.approx((-3.5, 1.5, 0.12), abs=1e-4)


@pytest.mark.parametrize(("name", "word"), [("fault_motor_dead", "fault"), ("field", "offset_m")])
def test_scenarios_that_px4_cannot_fly_are_refused_with_a_reason(name, word):
    with pytest.raises(ConfigError, match=word):
        Px4Plant(load_scenario(name), 1)
