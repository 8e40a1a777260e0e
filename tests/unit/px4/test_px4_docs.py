"""The page about PX4 on our plant says what the code does."""

import re
from pathlib import Path

import pytest

from flightstack.cli.real.px4_sim import px4_sim
from flightstack.config.files import load as load_config
from flightstack.verify.certificate import checks
from sim.plant.params import load
from sim.px4.airframe import FORMATS, PX4_OF_M, parameters
from sim.px4.sensors import DECLINATION_RAD, INCLINATION_RAD, STRENGTH_GAUSS
from sim.scenarios.scenario import Airframe

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "how_to" / "px4_sim.md").read_text()


def table():
    found = [parameters(load(airframe)) for airframe in (Airframe.CRAZYFLIE20, Airframe.QUAD_1000G)]
    rows = [f"| {name} | {found[0][name]} | {found[1][name]} |" for name in found[0]]
    return "\n".join(["| parameter | crazyflie20 | quad_1000g |", "|---|---|---|", *rows])


def test_the_table_of_parameters_is_what_the_verb_prints():
    assert re.search(r"<!-- table: parameters -->\n(.*?)\n<!-- end -->", PAGE, re.DOTALL)[1] == table()


def test_the_table_of_configurations_has_their_lags_and_pads():
    rows = re.findall(r"^\| `([\w-]+)` \| `(\w+)` \| ([0-9.]+) s, ([0-9.]+) s \| ([0-9.]+) m \|$", PAGE, re.M)
    assert [scenario for _, scenario, *_ in rows] == ["grid", "large"]
    for name, _, sideways, vertical, pad in rows:
        config = load_config(name)
        loop = config.velocity_loop
        assert (loop.lag_xy_s, loop.lag_z_s) == (float(sideways), float(vertical))
        assert config.touchdown.pad_radius_m == float(pad)
        assert config.checks.follow_lag_max_s > loop.lag_xy_s * (1.0 + config.envelope.lag_spread)


@pytest.mark.parametrize("name", ["px4-crazyflie", "px4-1kg", "ardupilot-1kg"])
def test_the_configurations_for_real_autopilots_are_proven(name):
    assert [result.name for result in checks(load_config(name)) if not result.proven] == []


def test_the_table_of_motors_is_the_order_of_the_code():
    rows = re.findall(r"^\| (\d) \| [a-z ]+ \| [a-z-]+ \| M(\d) \|$", PAGE, re.MULTILINE)
    assert {int(ours): int(px4) for px4, ours in rows} == {i + 1: px4 + 1 for i, px4 in enumerate(PX4_OF_M)}


def test_the_page_names_every_option_of_its_own_and_every_form():
    own = {o for p in px4_sim.params for o in p.opts} - {"--help", "--zenoh-config"}
    assert [option for option in sorted(own) if option not in PAGE] == []
    (form,) = (p for p in px4_sim.params if p.name == "form")
    assert set(form.type.choices) == set(FORMATS)


def test_the_magnetic_field_is_that_of_px4_s_tables_at_the_origin():
    # corners of geo_magnetic_tables.hpp around the origin: rows 40 and 50 N, columns 0 and 10 E
    tables = {
        DECLINATION_RAD: (218, 580, 157, 660, 1e-4),
        INCLINATION_RAD: (9581, 9746, 11387, 11493, 1e-4),
        STRENGTH_GAUSS: (4513, 4593, 4860, 4911, 1e-4),
    }
    north, east = 0.7397742, 0.8545594
    for value, (a, b, c, d, unit) in tables.items():
        low, high = a + east * (b - a), c + east * (d - c)
        assert abs(value - (low + north * (high - low)) * unit) < 2e-5
