"""Vehicles other than the Crazyflie: their files, how they fly, and a configuration that knows their size."""

from dataclasses import replace

import pytest

from flightstack.config.files import load as load_config
from flightstack.verify.certificate import problems
from sim.plant.params import load
from sim.scenarios.scenario import Airframe, StartKind, Wind
from sim.scenarios.scenario import load as load_scenario
from sim.vehicle.vehicle import VehicleSim

TICK_MS = 10


def still(name):
    """The scenario's vehicle in still air, hovering, without spreads."""
    scenario = load_scenario(name)
    spec = replace(scenario.vehicle, mass_spread=0.0, motor_lag_spread=0.0, thrust_spread=0.0)
    assert scenario.start.kind is StartKind.HOVER
    return VehicleSim(replace(scenario, vehicle=spec, wind=Wind(), fault=()), 0)


def velocities(vehicle, velocity_enu_m_s, duration_s):
    """True velocities at every tick of a step."""
    found = []
    for _ in range(round(duration_s * 1000 / TICK_MS)):
        vehicle.set_velocity(velocity_enu_m_s, 0.0)
        vehicle.advance(TICK_MS)
        found.append(vehicle.truth().velocity_enu_m_s)
    return found


def rise_s(values, final):
    """Time to 63 % of a step."""
    return (next(i for i, v in enumerate(values) if abs(v) >= 0.632 * abs(final)) + 1) * TICK_MS / 1000.0


@pytest.mark.parametrize("airframe", Airframe)
def test_every_file_loads_and_can_hover_with_room(airframe):
    params = load(airframe)
    hover_n = params.body.mass_kg * params.contact.gravity_m_s2 / 4.0
    assert params.rotor.thrust_min_n < 0.1 * hover_n * 2.0
    assert 0.3 < hover_n / params.rotor.thrust_max_n < 0.7
    empty_rpm = (
        params.battery.speed_at_zero_v_rpm + params.battery.speed_per_volt_rpm * params.battery.empty_v
    )
    assert params.rotor.thrust_n(empty_rpm) > 1.3 * hover_n


def test_the_crazyflie_is_the_default_and_keeps_its_gains():
    assert load() == load(Airframe.CRAZYFLIE20)
    gains = load().velocity_gains
    assert (gains.xy_p, gains.xy_i, gains.z_p, gains.z_i) == (25.0, 1.0, 25.0, 15.0)


def test_one_kilogram_answers_velocities_as_px4s_simulator_does():
    """PX4 v1.16 SITL with its SIH quadrotor: 0.14 + 0.56 s horizontally, 0.08 + 0.15 s vertically."""
    vehicle = still("large")
    velocities(vehicle, (0.0, 0.0, 0.0), 2.0)
    along = [v[0] for v in velocities(vehicle, (1.0, 0.0, 0.0), 3.0)]
    assert rise_s(along, 1.0) == pytest.approx(0.70, rel=0.1)
    assert max(along) < 1.15
    vehicle = still("large")
    velocities(vehicle, (0.0, 0.0, 0.0), 2.0)
    down = [v[2] for v in velocities(vehicle, (0.0, 0.0, -0.5), 2.0)]
    assert rise_s(down, 0.5) == pytest.approx(0.23, rel=0.3)
    assert min(down) > -0.65


def test_the_configuration_file_is_the_scenarios():
    assert load_config("sitl-1kg") == load_scenario("large").onboard


def test_the_large_configuration_is_proven_and_made_for_its_vehicle():
    scenario = load_scenario("large")
    config, params = scenario.onboard, load(scenario.vehicle.airframe)
    assert problems(config) == []
    assert config.touchdown.feet_below_reference_m == -params.geometry.foot_bottom_m
    assert config.touchdown.pad_radius_m == scenario.target.pad_radius_m
    feet_m = 2**0.5 * (params.geometry.foot_offset_m + params.geometry.foot_radius_m)
    assert config.robust.corridor_m + feet_m < config.touchdown.pad_radius_m  # they all stand on the pad
    judged = (scenario.judge.alpha_1_m, scenario.judge.beta_m)
    assert judged == (config.barrier.alpha_1_m, config.barrier.beta_m)
