"""Tests vehicles other than the Crazyflie: files, flight behaviour, and a configuration for their size."""

from dataclasses import replace

import pytest

from flightstack.common.strict_toml import ConfigError
from flightstack.verify.certificate import problems
from sim.plant.params import Plant, able_to_hover, load
from sim.scenarios.scenario import load as load_scenario
from sim.scenarios.tables import VEHICLE_FILES, VehicleSpec, VelocityLoop, Wind
from sim.vehicle.vehicle import VehicleSim

TICK_MS = 10


def velocities(vehicle, velocity_enu_m_s, duration_s):
    """Return true velocities at every tick after a velocity step."""
    found = []
    for _ in range(round(duration_s * 1000 / TICK_MS)):
        vehicle.set_velocity(velocity_enu_m_s, 0.0)
        vehicle.advance(TICK_MS)
        found.append(vehicle.truth().velocity_enu_m_s)
    return found


@pytest.mark.parametrize("airframe", VEHICLE_FILES.names())
def test_every_file_loads_and_can_hover_with_room(airframe):
    params = load(airframe)
    hover_n = params.body.mass_kg * params.contact.gravity_m_s2 / 4.0
    assert params.rotor.thrust_min_n < 0.1 * hover_n * 2.0
    assert 0.3 < hover_n / params.rotor.thrust_max_n < 0.7
    load_v = params.battery.resistance_ohm * (params.battery.idle_current_a + params.battery.hover_current_a)
    empty_n = params.rotor.thrust_n(params.battery.speed_rpm(params.battery.empty_v - load_v))
    assert empty_n > hover_n  # thrust of one rotor with an empty battery


def room(seed=0, loop=VelocityLoop.PID, **spec):
    """Return a hovering vehicle with the parameters of the recorded flights."""
    spec = VehicleSpec("crazyflie21_room", loop, **spec)
    return VehicleSim(replace(load_scenario("lab"), vehicle=spec, wind=Wind(), fault=()), seed)


def test_a_vehicle_that_is_asked_to_hover_has_the_charge_for_it():
    spread = {"motor_spread": 0.12, "thrust_spread": 0.04, "battery_charge": (0.0, 0.05)}
    params, spec = load("crazyflie21_room"), VehicleSpec("crazyflie21_room", **spread)
    drawn = [Plant.draw(spec, seed) for seed in range(40)]
    able = [able_to_hover(plant, params, 1.04) for plant in drawn]
    charges = [(a.battery_charge, b.battery_charge) for a, b in zip(drawn, able, strict=True)]
    assert all(b >= a for a, b in charges)
    assert all(replace(b, battery_charge=a.battery_charge) == a for a, b in zip(drawn, able, strict=True))
    seed = max(range(40), key=lambda n: charges[n][1] - charges[n][0])  # seed whose charge is raised most
    climbs = [
        velocities(room(seed, hover_reserve=reserve, **spread), (0.0, 0.0, 0.3), 1.5)[-1][2]
        for reserve in (0.0, 1.04)
    ]
    assert climbs[0] < 0.0 < 0.1 < climbs[1]


def test_a_vehicle_file_of_ones_own_and_what_is_said_when_there_is_none(tmp_path):
    own = tmp_path / "mine.toml"
    own.write_text('base = "crazyflie21_room"\n[body]\nmass_kg = 0.035\n')
    assert load(str(own)).body.mass_kg == 0.035
    assert load(str(own)).rotor == load("crazyflie21_room").rotor
    with pytest.raises(
        ConfigError, match=r"'cf99'.*neither a file nor one of: crazyflie20, crazyflie21_room"
    ):
        VehicleSpec("cf99")
    broken = tmp_path / "broken.toml"
    broken.write_text("[body]\nmass = 1.0\n")
    with pytest.raises(ConfigError, match=r"broken\.toml: body\.mass: no unit; the key is body\.mass_kg"):
        load(str(broken))
    with pytest.raises(ConfigError, match="lower share comes first"):
        VehicleSpec(battery_charge=(0.5, 0.2))


def test_the_large_configuration_is_proven_and_made_for_its_vehicle():
    scenario = load_scenario("large")
    config, params = scenario.onboard, load(scenario.vehicle.airframe)
    assert problems(config) == []
    assert config.touchdown.feet_below_reference_m == -params.geometry.foot_bottom_m
    assert config.touchdown.pad_radius_m == scenario.target.pad_radius_m
    feet_m = 2**0.5 * (params.geometry.foot_offset_m + params.geometry.foot_radius_m)
    assert config.robust.corridor_m + feet_m < config.touchdown.pad_radius_m  # all feet fit on the pad
    assert scenario.judge is None  # the verdict uses the barrier that is flown
