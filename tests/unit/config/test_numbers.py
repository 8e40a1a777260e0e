"""Numbers that come in: NaN and infinity are refused, and values that exclude each other by name."""

import math
import warnings
from dataclasses import replace

import click
import pytest
from click.testing import CliRunner

from bridge.mavlink.server.parameters import Parameters, real
from flightstack.cli.main import VERBS, main
from flightstack.common.options import BadOptionError
from flightstack.common.strict_toml import ConfigError, from_table, to_table
from flightstack.config.files import load
from flightstack.config.options import numbers
from flightstack.core.parameters.flight import FlightConfig
from flightstack.verify.certificate import checks
from sim.scenarios.scenario import Scenario
from sim.scenarios.scenario import load as load_scenario

NO_NUMBERS = ("nan", "inf", "-inf", "NaN", "1e999")


def parameters(command, path=()):
    if isinstance(command, click.Group):
        for name in command.list_commands(None):
            yield from parameters(command.get_command(None, name), (*path, name))
    else:
        yield from ((path, each) for each in command.params)


def test_no_option_takes_what_is_no_number():
    """Each option of each verb that is a float, whatever its range."""
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


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_the_command_says_so(text):
    result = CliRunner().invoke(main, ["bridge", "crazyflie", "--uri", "usb://0", "--speed-max", text])
    assert result.exit_code == 2
    assert "--speed-max" in result.output


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_neither_do_parameters_of_the_vehicle(text):
    with pytest.raises(BadOptionError, match="finite"):
        numbers((f"COM_OF_LOSS_T={text}",))
    table = Parameters([real("A", 1.0, -1e38, 1e38)])
    with pytest.raises(ValueError, match="A"):
        table.preset("A", float(text))
    assert table.set("A", float(text), 9, armed=False) is not None
    assert table["A"] == 1.0


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


def test_a_velocity_loop_of_any_speed_is_judged():
    """At the widest spread the fastest loop is unstable beyond all numbers: not proven, no error."""
    storm = load_scenario("storm").onboard
    config = from_table(FlightConfig, to_table(changed(storm, envelope={"lag_spread": 0.9})))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refuted = [each for each in checks(config) if not each.proven]
    assert any("envelope.lag_spread" in (each.remedy or "") for each in refuted)
