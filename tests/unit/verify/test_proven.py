"""Flies a sample of the proven configurations; `python -m tests.benchmarks proven` flies all."""

import re
from dataclasses import replace

import pytest

from flightstack.common.strict_toml import ConfigError, from_table, to_table
from flightstack.verify.certificate import checks
from sim.scenarios.scenario import Scenario, load, names
from sim.scenarios.tables import Judge, OdometryLink, StateError
from sim.vehicle.declared import declared, outside
from tests.benchmarks.proven import FILTERS, SCENARIOS, cases, fly

pytestmark = pytest.mark.slow

EVERY = 797  # every 797th case of all keys, filters and scenarios is tested
SAMPLE = list(cases([], list(SCENARIOS), list(FILTERS), 5))[::EVERY]


@pytest.mark.parametrize(
    "case", SAMPLE, ids=lambda case: f"{case[0]} {case[1]} {'.'.join(case[2])} {case[3]}"
)
def test_what_is_proven_neither_crashes_nor_violates(case):
    assert fly(case, first_seed=0, runs=2).failures == ()


@pytest.mark.parametrize(
    ("scenario", "kind", "key", "value", "check"),
    [
        ("lab", "robust", "velocity_loop.error_max_m_s", 0.1, "velocity_loop.error_max_m_s"),
        ("field", "robust", "velocity_loop.rate_xy_1_s", 0.5, "velocity_loop.lag_xy_s"),
        ("deck", "robust", "robust.gain_1_s", 5.0, "lead, spread"),
        ("deck", "robust", "robust.descent_min_m_s", 1.0, "robust.descent_min_m_s"),
        ("lab", "robust", "checks.follow_memory_s", 5.3, "checks.follow_memory_s"),
        ("deck", "robust", "checks.target_jump_max_m", 0.02, "checks.target_jump_max_m"),
        ("field", "robust", "target.delay_s", 0.5, "target.delay_s"),
        ("field", "paper", "barrier.omega_1_s", 0.7, "lag"),
        ("deck", "paper", "position_loop.gain_1_s", [1.0, 1.0, 1.0], "lag"),
        ("reversing", "paper", "position_loop.gain_1_s", [10.0, 10.0, 10.0], "position loop"),
        ("reversing", "paper", "position_loop.gain_1_s", [0.188, 0.188, 0.188], "position loop, filter"),
        ("reversing", "paper", "position_loop.gain_1_s", [1.0, 1.0, 10.0], "position loop, vertical"),
        ("reversing", "paper", "limits.velocity_max_m_s", [0.1581] * 3, "limits.velocity_max_m_s"),
        ("lab", "paper", "velocity_loop.lag_xy_s", 0.06325, "velocity_loop.lag_xy_s"),
        ("reversing", "paper", "barrier.omega_1_s", 20.0, "barrier.omega_1_s"),
        ("reversing", "paper", "barrier.alpha_1_m", 0.05, "cone"),
        ("reversing", "paper", "barrier.alpha_1_m", 4.472, "climb"),
        ("reversing", "paper", "limits.slew_max_m_s2", [0.2, 0.2, 0.2], "slew"),
        ("reversing", "paper", "loop.rate_hz", 10, "tick"),
        ("reversing", "paper", "contact.gap_m", 0.1, "contact.gap_m"),
        ("ardupilot_47", "robust", "velocity_loop.error_max_m_s", 1.0, "velocity_loop.error_max_m_s"),
        ("large", "robust", "velocity_feedback.horizontal", True, "velocity feedback, model"),
        (
            "large+feedback",
            "robust",
            "velocity_loop.error_max_m_s",
            2.659,
            "velocity_loop.error_max_m_s, feedback",
        ),
        ("field", "robust", "target.velocity_noise_m_s", 1e-4, "declared, target.velocity_noise_m_s"),
    ],
)
def test_what_crashed_though_it_was_proven_is_not_proven(scenario, kind, key, value, check):
    found = fly((scenario, kind, tuple(key.split(".")), value), first_seed=0, runs=0)
    assert found.verdict in ("not proven", "refused")
    assert check in found.because


@pytest.mark.parametrize(("key", "value"), [("acceleration_max_m_s2", 0.2), ("observer_rate_1_s", 1.5)])
def test_a_feedback_with_a_value_that_made_landings_violate_is_not_proven(key, value):
    table = to_table(load("lab"))
    table["onboard"]["velocity_feedback"] |= {"horizontal": True, key: value}
    found = [each.name for each in checks(from_table(Scenario, table).onboard) if not each.proven]
    assert found == [f"velocity_feedback.{key}"]


def changed(scenario: Scenario, **parts: dict) -> list[str]:
    """Return the names of the checks that are not proven for a scenario with these changes."""
    for name, values_ in parts.items():
        scenario = replace(scenario, **{name: replace(getattr(scenario, name), **values_)})
    return [check.name for check in declared(scenario) if not check.proven]


def test_each_scenario_declares_what_it_flies():
    for name in names():
        assert changed(load(name)) == (["declared, start"] if name == "unsafe" else []), name


@pytest.mark.parametrize(
    ("part", "key", "value", "check"),
    [
        ("judge", "alpha_1_m", 1.2, "barrier"),
        ("judge", "beta_m", 1.6, "barrier"),
        ("odometry", "loss", 0.5, "odometry.loss"),
        ("odometry", "dropout_max_s", 1.0, "odometry.dropout_max_s"),
        ("odometry", "yaw_noise_rad", 0.1, "odometry.yaw_noise_rad"),
        ("odometry", "error", StateError(delay_s=0.15), "target.delay_s"),
        ("vehicle", "own", StateError(delay_s=0.15), "own.delay_s"),
        ("vehicle", "mocap", OdometryLink(20.0, 0.001, 0.0, 0.005, 0.02), "vehicle.mocap.rate_hz"),
        ("vehicle", "mocap", OdometryLink(loss=0.3, delay_s=0.02), "vehicle.mocap.loss"),
        ("vehicle", "mocap", OdometryLink(dropout_max_s=1.0, delay_s=0.02), "vehicle.mocap.dropout_max_s"),
        ("vehicle", "mocap", OdometryLink(yaw_noise_rad=0.1, delay_s=0.02), "vehicle.mocap.yaw_noise_rad"),
        ("vehicle", "motor_spread", 0.3, "vehicle.motor_spread"),
        ("vehicle", "battery_charge", (0.1, 1.0), "vehicle.battery_charge"),
        ("vehicle", "slow_motors", True, "vehicle.slow_motors"),
        ("vehicle", "ground_effect_gain", 5.0, "vehicle.ground_effect_gain"),
        ("start", "offset_m", (0.0, 0.0, 3.5), "limits.altitude_max_m"),
        ("target", "speed_m_s", 0.6, "touchdown.target_speed_max_m_s"),
        ("target", "turn_rate_rad_s", 2.0, "envelope.target_acceleration_max_m_s2"),
        ("target", "acceleration_max_m_s2", 1.0, "envelope.target_acceleration_max_m_s2"),
        ("target", "heave_amplitude_m", 0.1, "envelope.target_climb_max_m_s"),
        ("target", "heave_rate_hz", 1.0, "envelope.target_climb_max_m_s"),
        ("odometry", "rate_hz", 40.0, "envelope.target_rate_hz"),
        ("odometry", "delay_s", 0.1, "target.delay_s"),
        ("odometry", "position_noise_m", 0.03, "target.position_noise_m"),
        ("odometry", "velocity_noise_m_s", 0.1, "target.velocity_noise_m_s"),
        ("vehicle", "airframe", "quad_1000g", "touchdown.feet_below_reference_m"),
        ("vehicle", "mass_spread", 0.3, "envelope.lag_spread"),
        ("vehicle", "thrust_spread", 0.3, "envelope.lag_spread"),
        ("vehicle", "motor_lag_spread", 0.5, "envelope.lag_spread"),
        ("vehicle", "setpoint_delay_s", 0.1, "velocity_loop.lag_xy_s"),
        ("vehicle", "mocap", OdometryLink(delay_s=0.1), "own.delay_s"),
        ("vehicle", "mocap", OdometryLink(position_noise_m=0.05, delay_s=0.01), "own.position_noise_m"),
        ("wind", "gust_rms_m_s", 2.0, "robust.tracking_error_m_s"),
        ("wind", "mean_m_s", 3.0, "wind.mean_m_s"),
        ("start", "h_m", (-0.1, 1.2), "start"),
        ("start", "offset_m", (1.0, 0.0, 0.1), "start"),
    ],
)
def test_a_scenario_that_is_not_as_declared_is_not_proven(part, key, value, check):
    scenario = load("field")
    if key.startswith("heave"):  # the unchanged scenario already heaves a little, as declared
        heaves = replace(scenario.target, heave_amplitude_m=0.02, heave_rate_hz=0.1)
        envelope = replace(scenario.onboard.envelope, target_climb_max_m_s=0.02)
        scenario = replace(scenario, target=heaves, onboard=replace(scenario.onboard, envelope=envelope))
    if key == "speed_m_s":
        scenario = replace(scenario, target=replace(scenario.target, speed_max_m_s=1.0))
    if part == "judge":
        scenario = replace(scenario, judge=Judge(1.0, 1.5))
    assert changed(scenario) == []
    left = replace(scenario, **{part: replace(getattr(scenario, part), **{key: value})})
    assert f"declared, {check}" in changed(left)
    assert key in outside([left]) or check in outside([left])
    (remedy,) = (each.remedy for each in declared(left) if each.name == f"declared, {check}")
    told = re.match(r"set onboard\.([^.]+)\.(\S+) to ([\d.]+)", remedy)
    if told and key != "airframe":  # a larger airframe needs changes of other keys, too
        section, name, number = told.groups()
        table = to_table(left)
        table["onboard"][section][name] = float(number)
        assert f"declared, {check}" not in changed(from_table(Scenario, table))


@pytest.mark.parametrize("kind", ["robust", "paper"])
@pytest.mark.parametrize(("pad_m", "stands"), [(0.05, False), (0.06, False), (0.08, True)])
def test_a_pad_without_room_for_the_feet_is_not_proven(kind, pad_m, stands):
    table = to_table(load("lab").with_filter(kind))
    table["target"]["pad_radius_m"] = table["onboard"]["touchdown"]["pad_radius_m"] = pad_m
    # other values with which every other claim is proven, also for small pads
    table["onboard"]["limits"]["velocity_max_m_s"] = [0.35, 0.35, 0.5]
    table["onboard"]["robust"] |= {
        "fade_radius_m": 0.03, "corridor_m": 0.05, "commit_radius_m": 0.009, "commit_speed_m_s": 0.059,
        "acceleration_max_m_s2": [1.2, 1.2, 2.5],
    }  # fmt: skip
    found = from_table(Scenario, table)
    assert changed(found) == ([] if stands else ["declared, feet"])
    if kind == "robust":
        assert all(each.proven for each in checks(found.onboard))
    (feet,) = (each for each in declared(found) if each.name == "declared, feet")
    least_m = float(feet.remedy.split(" to ")[1].split(" or ")[0])
    table["target"]["pad_radius_m"] = table["onboard"]["touchdown"]["pad_radius_m"] = least_m
    assert changed(from_table(Scenario, table)) == []


@pytest.mark.parametrize(
    ("own", "text"),
    [
        ("[onboard.touchdown]\npad_radius_m = 0.2", "there is one pad"),
        ("[target]\nturn_rate_rad_s = 2.9", "above target.turn_rate_max_rad_s"),
        ("[target]\nspeed_m_s = 2.9", ": raise target.speed_max_m_s, or lower target.speed_m_s"),
        ("[target]\npad_radius_m = 0.03", r"toml: target\.pad_radius_m: found 0.03, allowed: 0.05 to 2"),
        ("[target]\npad_radius_m = 10", r"toml: target\.pad_radius_m: found 10, allowed: 0.05 to 2"),
    ],
)
def test_wrong_numbers_and_two_that_must_agree_are_refused_over_a_base_too(tmp_path, own, text):
    (tmp_path / "mine.toml").write_text(f'base = "lab"\n{own}\n')
    with pytest.raises(ConfigError, match=text):
        load(tmp_path / "mine.toml")


def test_barrier_of_the_verdict_and_pad_of_the_configuration_follow_from_what_a_file_gives(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'base = "large"\n[target]\npad_radius_m = 0.4\n[onboard.barrier]\nbeta_m = 3.0\n'
    )
    scenario = load(tmp_path / "mine.toml")
    assert scenario.onboard.touchdown.pad_radius_m == 0.4
    assert scenario.judged_by == scenario.onboard.barrier
