"""Vehicle parameters fitted to flights: those of simulated flights are found, bad input is reported."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from click.testing import CliRunner

from flightstack.cli.identify import identify
from sim.flights.recording import read_columns
from sim.flights.screening import load as load_flight
from sim.flights.screening import screen
from sim.plant.params import Plant, load
from sim.validation.fit import Values, fit_flight, fitted, start_values, together
from sim.validation.identified import toml
from tests.recorded import PIECE, flights
from tests.unit.validation.test_closed_loop import AIRFRAME, recorded

ROOM = load("crazyflie21_room")
TRUE = start_values(ROOM)


@cache
def own_fit(plant):
    """Fit a simulated flight, starting from wrong numbers."""
    wrong = TRUE._replace(
        hover_v=2.6, exponent=1.7, lag_s=0.03, drag_1_s=0.5, inertia_kg_m2=2.4e-5, drag_above_com_m=0.02,
        rate_damping_1_s=2.0,
    )  # fmt: skip
    found = fit_flight(screen(recorded(plant)), fitted(ROOM, wrong))
    assert found is not None
    return found


# allowed relative errors: commands at 500 Hz, logged at 100 Hz, leave some per cent
WITHIN = Values(0.005, 0.03, 0.12, 0.05, 0.2, 0.1, 0.1, 0.5, 2.0, 0.1)


@pytest.mark.parametrize("plant", [Plant(battery_charge=0.6), AIRFRAME])
def test_the_simulators_numbers_are_found_again(plant):
    found = own_fit(plant)
    true = TRUE._replace(hover_v=TRUE.hover_v * plant.thrust ** (-1.0 / TRUE.exponent))
    for name, share, value, wanted in zip(Values._fields, WITHIN, found.values, true, strict=True):
        assert value == pytest.approx(wanted, rel=share), name
    assert all(
        0.0 < error < 0.1 * abs(value) + 1e-3 for error, value in zip(found.errors, found.values, strict=True)
    )


def test_intervals_hold_the_median_and_grow_with_the_spread():
    chance = np.random.default_rng(3)
    one = own_fit(AIRFRAME)

    def made(spread):
        return [
            replace(one, values=one.values._replace(lag_s=0.05 + spread * float(chance.normal())))
            for _ in range(30)
        ]

    narrow, wide = (together(made(spread)).numbers["lag_s"] for spread in (0.001, 0.01))
    for number in (narrow, wide):
        assert number.low <= number.value <= number.high
    assert wide.high - wide.low > 3.0 * (narrow.high - narrow.low)
    alone = together([one]).numbers["lag_s"]
    assert alone.high - alone.low == pytest.approx(2 * 1.96 * one.errors.lag_s)
    with pytest.raises(ValueError, match="no flight"):
        together([])


def test_the_file_that_is_written_can_be_loaded_and_flown(tmp_path):
    fit = together([own_fit(AIRFRAME)])
    path = tmp_path / "mine.toml"
    path.write_text(toml(fit, ROOM, "crazyflie21_room"))
    vehicle = load(str(path))
    for name, value, wanted in zip(Values._fields[:-2], start_values(vehicle), fit.values, strict=False):
        assert value == pytest.approx(wanted, rel=0.01), name
    assert vehicle.body.mass_kg == ROOM.body.mass_kg
    second = tmp_path / "second.toml"
    second.write_text(toml(fit, ROOM, str(path)))
    assert load(str(second)) == vehicle


def run(*arguments):
    return CliRunner().invoke(identify, [str(argument) for argument in arguments])


def test_the_verb_fits_a_folder_and_tells_what_it_left_out(tmp_path):
    (tmp_path / "B3_figure8_rep1.parquet").write_bytes(PIECE.read_bytes())
    columns = pa.parquet.read_table(PIECE)
    pa.parquet.write_table(columns.slice(0, 10), tmp_path / "short.parquet")
    pa.parquet.write_table(columns.drop_columns(["px"]), tmp_path / "other.parquet")
    grounded = columns.set_column(columns.column_names.index("pz"), "pz", pa.array(np.zeros(len(columns))))
    pa.parquet.write_table(grounded, tmp_path / "grounded.parquet")
    holes = columns.set_column(
        columns.column_names.index("px"), "px", pa.array(np.full(len(columns), np.nan))
    )
    pa.parquet.write_table(holes, tmp_path / "nan.parquet")
    out = tmp_path / "vehicle.toml"
    result = run("--flights", tmp_path, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["flights"], told["used"]) == (5, 1)
    assert set(told["left_out"]) == {"short", "other", "grounded", "nan"}
    assert all(told["left_out"].values())
    assert load(str(out)).rotor.lag_s == pytest.approx(told["numbers"]["lag_s"]["value"], abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "found neither LOG nor --flights"),
        (["--flights", "."], "no recordings|found no|\\.parquet"),
        (["--flights", ".", "--vehicle", "cf99"], "neither a file nor one of"),
    ],
)
def test_wrong_input_is_named(tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    result = run(*arguments)
    assert result.exit_code != 0
    assert re.search(says, result.output + str(result.exception))


def test_real_flights_agree_with_the_vehicles_file():
    for path in flights("B7_oval_medium_rep2"):
        found = fit_flight(load_flight(path, read_columns()), ROOM)
        assert found is not None
        assert found.values.hover_v == pytest.approx(TRUE.hover_v, rel=0.06)
        assert found.values.lag_s == pytest.approx(TRUE.lag_s, rel=0.6)
        assert found.values.inertia_kg_m2 == pytest.approx(TRUE.inertia_kg_m2, rel=0.5)
