"""Tests that valid configurations are accepted, and invalid configurations rejected with the reason."""

import dataclasses
import math
import tomllib
from dataclasses import replace
from functools import partial

import click
import pytest

from flightstack.cli.main import VERBS, main
from flightstack.common.strict_toml import ConfigError, dumps, from_table, to_table
from flightstack.config import load, names, path_of
from flightstack.core.parameters.filters import check_name, named, referred
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.strategies.packaged.robust import RobustFilter
from flightstack.verify.certificate import problems
from sim.scenarios import scenario
from sim.scenarios.scenario import Scenario
from sim.scenarios.scenario import load as load_scenario

PAPER = {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5}}


def config(**sections):
    return from_table(FlightConfig, {**PAPER, **sections})


def paper(**sections):
    return config(filter="paper", **sections)


@pytest.mark.parametrize(
    ("sections", "words"),
    [
        (
            {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5, "gamma": 1}},
            ["barrier.gamma", "unknown key", "alpha_1_m"],
        ),
        (
            {"barrier": {"alpha_m": 1.0, "beta_m": 1.5}},
            ["wrong unit", "found [m]", "the key is barrier.alpha_1_m"],
        ),
        ({"checks": {"hold_time_ms": 1000.0}}, ["wrong unit", "found [ms]", "hold_time_s"]),
        ({"checks": {"hold_tim_s": 1.0}}, ["unknown key", "did you mean hold_time_s"]),
        ({"loop": {"rate_hz": 1000}}, ["loop.rate_hz", "1000", "10 to 500"]),
        ({"loop": {"rate_hz": 100.5}}, ["loop.rate_hz: found 100.5", "an integer"]),
        (
            {"limits": {"velocity_max_m_s": [0.2, 0.2]}},
            ["velocity_max_m_s: found [0.2, 0.2]", "an array of 3 values"],
        ),
        ({"barrier": {"alpha_1_m": 1.0}}, ["barrier.beta_m: missing"]),
        ({"barrier": {"peak_distance_m": 1.0}}, ["barrier: peak_height_m: missing"]),
        ({"barrier": {"peak_height_m": 0.55}}, ["either peak_distance_m or cone_half_angle_rad"]),
        ({"barrier": {"peak_height_m": 0.55, "cone_half_angle_rad": 2}}, ["found 2", "0.05 to 1.5"]),
        (
            {"barrier": {"peak_height_m": 0.5, "cone_half_angle_rad": 0.05}},
            ["cone_half_angle_rad: found 0.05", "0.025 m from", "0.05 to 20"],
        ),
        (
            {"barrier": {"peak_height_m": 0.55, "peak_distance_m": 1.0, "beta_m": 1.5}},
            ["barrier: found peak_height_m, peak_distance_m, beta_m", "alpha_1_m = 1, beta_m = 1.495"],
        ),
        ({"barrier": {"alpha_1_m": 1.0, "beta_m": float("nan")}}, ["beta_m", "finite"]),
        ({"filter": "best"}, ["filter", "'best'", "paper, robust"]),
        ({"limits": {"altitude_max_m": 0.6}}, ["altitude_max_m", "peak"]),
        ({"barrier": 3}, ["barrier: found 3", "a table [barrier]"]),
        (
            {"loop": {"rate_hz": 10}, "velocity_loop": {"rate_z_1_s": 11.0, "damping": 0.7}},
            [
                "velocity_loop.rate_z_1_s",
                "found 11",
                "damping 0.7",
                "rate_hz 10",
                "10.41",
                "raise loop.rate_hz",
            ],
        ),
        (
            {"loop": {"rate_hz": 10}, "velocity_loop": {"rate_xy_1_s": 30.0}},
            ["velocity_loop.rate_xy_1_s", "found 30", "lower it"],
        ),
        (
            {"robust": {"fade_radius_m": 0.051}, "touchdown": {"pad_radius_m": 0.05}},
            ["robust.fade_radius_m", "found 0.051", "at most the pad's radius, 0.05 m"],
        ),
    ],
)
def test_wrong_configurations_are_refused_with_the_reason(sections, words):
    with pytest.raises(ConfigError) as error:
        config(**sections)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("sections", "word"),
    [
        # slope 1.5, limits 0.2 and 0.5 m/s: 0.5 + 1.5 (0.2 - v) >= 0 allows target speeds v <= 0.533 m/s
        ({"touchdown": {"target_speed_max_m_s": 0.54}}, "outruns the box"),
        (
            {"barrier": {"alpha_1_m": 1.0, "beta_m": 1.5, "omega_1_s": 20.0}, "loop": {"rate_hz": 20}},
            "omega_1_s",
        ),
        ({"limits": {"slew_max_m_s2": [50.0, 50.0, 50.0]}}, "slew_max_m_s2[0]"),
        ({"barrier": {"alpha_1_m": 20.0, "beta_m": 0.1}, "touchdown": {"pad_radius_m": 0.2}}, "peak"),
    ],
)
def test_infeasible_sets_are_found(sections, word):
    assert any(word in problem for problem in problems(paper(**sections)))


@pytest.mark.parametrize(("read", "known"), [(load, "crazyflie"), (scenario.load, "paper_moving_1")])
def test_what_does_not_exist_is_refused_with_the_names(read, known):
    with pytest.raises(ConfigError, match=f"'nowhere': neither a file nor one of: .*{known}"):
        read("nowhere")


@pytest.mark.parametrize(
    ("read", "name", "error"),
    [
        (load, "crazyfly", "; did you mean crazyflie[?]$"),
        (scenario.load, "fleet3", "; did you mean fleet_3[?]$"),
        (scenario.load, "mine.toml", "'mine.toml': there is no file /.*mine.toml$"),
        (named, "examples.own_filter:Smoth", "own_filter.py[)] has no Smoth$"),
        (named, "sys:Smooth", r"module sys [(]built in[)] has no Smooth$"),
        (
            partial(referred, key="target.function"),
            "examples.own_boundary:certifcate",
            "own_boundary.py[)] has no certifcate$",
        ),
        (check_name, "robst", "; did you mean robust[?]$"),
        (check_name, "a/mine.py:Slower", "; did you mean a.mine:Slower[?]$"),
    ],
)
def test_a_name_that_is_nearly_right_is_answered_with_the_right_one(read, name, error):
    with pytest.raises(ConfigError, match=error):
        read(name)


def test_an_unknown_key_at_the_top_of_a_file_is_answered_with_the_keys_of_files(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('base = "crazyflie"\nfiltr = "robust"\n')
    with pytest.raises(ConfigError, match=r"did you mean filter[?] allowed: barrier, base, checks, "):
        load(file)


def test_a_table_of_the_configuration_at_the_top_of_a_scenario_is_answered_with_its_place(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('base = "lab"\n[barrier]\nalpha_1_m = 1.0\n')
    with pytest.raises(ConfigError, match=r"barrier: unknown key; did you mean onboard\.barrier[?] "):
        scenario.load(file)


@pytest.mark.parametrize("name", scenario.names())
def test_every_scenario_loads_is_feasible_and_survives_writing(name):
    loaded = scenario.load(name)
    assert problems(loaded.onboard) == []
    assert from_table(scenario.Scenario, tomllib.loads(dumps(loaded))) == loaded


def test_a_file_has_what_it_leaves_out_from_its_base(tmp_path):
    windy, late = tmp_path / "windy.toml", tmp_path / "late.toml"
    windy.write_text('base = "lab"\nname = "windy"\n[wind]\nmean_m_s = 1.0\n')
    late.write_text('base = "windy.toml"\n[odometry]\ndelay_s = 0.1\n')
    lab = scenario.load("lab")
    wanted = dataclasses.replace(
        lab,
        name="late",
        wind=dataclasses.replace(lab.wind, mean_m_s=1.0),
        odometry=dataclasses.replace(lab.odometry, delay_s=0.1),
    )
    assert scenario.load(late) == wanted
    windy.write_text('base = "late.toml"\n')
    late.write_text('base = "lab"\nname = "own"\n')
    assert (scenario.load(windy).name, scenario.load(late).name) == ("windy", "own")


def test_a_barrier_may_be_given_by_its_peak_but_not_over_a_base_with_alpha_and_beta(tmp_path):
    by_angle = config(barrier={"peak_height_m": 0.55, "cone_half_angle_rad": math.radians(60.0)}).barrier
    assert (by_angle.alpha_1_m, by_angle.beta_m) == pytest.approx((1.0498, 1.4951), abs=1e-4)
    assert (by_angle.peak_height_m, by_angle.peak_distance_m) == pytest.approx((0.55, 0.9526), abs=1e-4)
    by_distance = config(barrier={"peak_height_m": 0.55, "peak_distance_m": 0.5, "omega_1_s": 1.0}).barrier
    assert (by_distance.peak_distance_m, by_distance.omega_1_s) == (0.5, 1.0)
    mine = tmp_path / "mine.toml"
    mine.write_text('base = "crazyflie"\n[barrier]\npeak_height_m = 0.55\npeak_distance_m = 1.0\n')
    with pytest.raises(ConfigError, match=r"mine\.toml: barrier: found .* alpha_1_m, beta_m \(a base file"):
        load(mine)


@pytest.mark.parametrize(
    ("base", "error"),
    [
        ("3", r"base: found 3, the name of a scenario or a file is needed"),
        ('"nowhere"', r"mine\.toml: base: scenario 'nowhere': neither a file nor one of: .*lab"),
        ('"mine.toml"', r"base: found 'mine\.toml', which has this file as its base; remove one"),
    ],
)
def test_a_wrong_base_is_refused(tmp_path, base, error):
    (tmp_path / "mine.toml").write_text(f"base = {base}\n")
    with pytest.raises(ConfigError, match=error):
        scenario.load(tmp_path / "mine.toml")


def test_the_documented_configuration_names_every_key_and_its_default():
    file = path_of("crazyflie")
    documented = to_table(load(file))
    defaults = to_table(config())
    text = file.read_text()
    for section, values in to_table(from_table(FlightConfig, PAPER)).items():
        assert section in text
        for key in values if isinstance(values, dict) else ():
            assert key in text
    changed = {"limits", "touchdown", "takeoff", "checks", "own"}
    assert {k: v for k, v in documented.items() if k not in changed} == {
        k: v for k, v in defaults.items() if k not in changed
    }


@pytest.mark.parametrize("name", names())
def test_every_configuration_that_comes_with_the_package_is_found_by_name_and_may_fly(name):
    assert problems(load(name)) == []


def test_the_margin_is_at_most_1_6_times_the_one_without_fading():
    """The filter divides the margin by the fraction that remains at the pad's edge, at least 1 - 1/e."""
    for pad_m in (0.05, 0.1, 0.5):
        widest = config(
            robust={"fade_radius_m": pad_m, "tracking_error_m_s": 0.1, "rate_1_s": 1.0, "sigma_factor": 0.0},
            touchdown={"pad_radius_m": pad_m},
        )
        filter_ = RobustFilter(widest, widest.barrier)
        assert 0.1 < filter_.margin_m(0.0, 0.0) < 0.16


NO_NUMBERS = ("nan", "inf", "-inf", "NaN", "1e999")


def parameters(command, path=()):
    if isinstance(command, click.Group):
        for name in command.list_commands(None):
            yield from parameters(command.get_command(None, name), (*path, name))
    else:
        yield from ((path, each) for each in command.params)


def test_no_option_takes_what_is_no_number():
    """Each float option of each subcommand rejects NaN and infinity, whatever its range."""
    seen = [
        (path, each) for path, each in parameters(main) if isinstance(each.type, click.types.FloatParamType)
    ]
    assert len(seen) >= 20
    assert {path[0] for path, _ in seen} >= {"fly", "bridge", "px4-sim", "watch"}
    for path, each in seen:
        for text in NO_NUMBERS:
            with pytest.raises(click.BadParameter):
                each.type.convert(text, each, None)
        assert each.type.convert("1.0", each, None) == 1.0, path
    assert VERBS


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf, 10**400])
@pytest.mark.parametrize(
    "key", ["target.position_m.0", "target.heading_rad", "wind.mean_m_s", "onboard.limits.velocity_max_m_s.2"]
)
def test_files_neither(key, number):
    table = to_table(load_scenario("field"))
    *sections, last = (int(part) if part.isdigit() else part for part in key.split("."))
    inner = table
    for section in sections:
        inner = inner[section]
    inner[last] = number
    with pytest.raises(ConfigError, match=sections[0]):
        from_table(Scenario, table)


def changed(config, **sections):
    parts = {name: replace(getattr(config, name), **values) for name, values in sections.items()}
    return replace(config, **parts)


ROBUST = replace(load("crazyflie"), filter="robust")


@pytest.mark.parametrize(
    ("config", "keys"),
    [
        (lambda: changed(ROBUST, touchdown={"feet_below_reference_m": 0.38}), ("wait_height_m", "feet_")),
        (
            lambda: changed(ROBUST, robust={"wait_height_m": 0.5}, touchdown={"feet_below_reference_m": 0.3}),
            ("commit_height_m", "feet_below_reference_m"),
        ),
        (
            lambda: replace(load_scenario("deck").target, heave_amplitude_m=0.3),
            ("heave_amplitude_m", "pad_height_m"),
        ),
        (
            lambda: replace(load_scenario("field").target, pad_height_m=0.05, heave_amplitude_m=0.04),
            ("heave_amplitude_m", "pad_height_m"),
        ),
    ],
)  # fmt: skip
def test_values_that_exclude_each_other_name_the_keys(config, keys):
    with pytest.raises(ConfigError) as raised:
        config()
    for key in keys:
        assert key in str(raised.value)
