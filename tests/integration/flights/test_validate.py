"""Tests ``flightstack validate``: a short flight, the recorded flights if their folder exists, bad input."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest

from tests import recorded
from tests.integration.runs import called


def validate(folder, out, *options, code=None):
    few = len(list(folder.iterdir())) < 20  # few flights run in this process, in which all is compiled
    workers = ("--workers", 1) if few else ()
    done = called("validate", folder, "--json", "--out", out, *workers, *options)
    assert "Traceback" not in done.err
    told = done.json
    assert done.code == (0 if told["passed"] else 1) if code is None else done.code == code, done.err
    assert told["flights"] == told["used"] + len(told["left_out"])
    assert bool(told["causes"]) != told["passed"]
    return told, done.err


def table():
    """Return the columns of the short flight as arrays, which a test may change."""
    read = pa.parquet.read_table(recorded.PIECE)
    return {name: np.array(read[name]) for name in read.column_names}


def write(path, columns):
    pa.csv.write_csv(pa.table(columns), path)


def changed(names, change):
    columns = table()
    for name in names:
        columns[name] = change(columns[name])
    return columns


def nan_for_a_while(values):
    values = values.astype(float)
    values[210:215] = np.nan
    return values


BAD = {
    "ground": (lambda: changed(["pz"], lambda v: 0.03 + 0.0 * v), "in the air for 0.0 s only"),
    "nan": (lambda: changed(["px"], lambda v: v * np.nan), "0.0 s left of 4.0 s in the air"),
    "short": (
        lambda: {name: v[:10] for name, v in table().items()},
        "found 10 samples, at least 200 are needed",
    ),
}


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """Return the result of ``validate`` on a good flight, one with a gap, and one flight of each bad kind."""
    folder = tmp_path_factory.mktemp("mixed")
    shutil.copy(recorded.PIECE, folder / "good.parquet")
    write(folder / "hole.csv", changed(["qx"], nan_for_a_while))
    for name, (columns, _) in BAD.items():
        write(folder / f"{name}.csv", columns())
    (folder / "broken.parquet").write_bytes(b"no parquet")
    (folder / "notes.txt").write_text("not read")
    return validate(folder, tmp_path_factory.mktemp("out"))


def test_bad_flights_are_told_one_line_each_and_the_others_go_on(mixed):
    told, said = mixed
    assert told["flights"] == len(BAD) + 3
    assert [one["name"] for one in told["by_flight"]] == ["good", "hole"]
    reasons = {one["name"]: "; ".join(one["reasons"]) for one in told["left_out"]}
    assert set(reasons) == {*BAD, "broken"}
    for name, (_, says) in BAD.items():
        assert says in reasons[name]
        (line,) = (line for line in said.splitlines() if line.startswith(f"{name}: left out: "))
        assert says in line
    (cut,) = told["cut"]
    assert cut["name"] == "hole"
    assert "values missing" in cut["reasons"][0]


def test_csv_and_parquet_tell_the_same_and_every_part_is_there(mixed):
    told, _ = mixed
    good, hole = told["by_flight"]
    for errors in good["open_loop"]["horizons"]:
        for quantity in ("position_m", "velocity_m_s", "attitude_rad"):
            assert all(errors[quantity][p] > 0.0 for p in ("model", "constant_velocity", "ideal"))
    assert None not in (good["closed_loop"], hole["closed_loop"])
    assert good["used_s"] > hole["used_s"] > 3.0
    assert good["sensing"]["recorded"]["position"]["delay_s"] is not None


def test_nothing_left_is_exit_status_1(tmp_path):
    told, said = validate(tmp_path, tmp_path / "out", code=1)
    assert "found no flights" in said
    assert told["causes"] == ["nothing is left to compare with"]
    columns, says = BAD["short"]
    write(tmp_path / "short.csv", columns())
    told, said = validate(tmp_path, tmp_path / "out", code=1)
    assert says in said
    assert (told["flights"], told["used"], told["passed"]) == (1, 0, False)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("nowhere",), "nowhere"),
        ((recorded.PIECE.parent, "--vehicle", "nothing"), "neither a file nor one of"),
    ],
)
def test_wrong_input_exits_2(tmp_path, words, says):
    done = called("validate", *words, "--out", tmp_path)
    assert done.code == 2
    assert says in done.err
    assert "Traceback" not in done.err


def test_the_terminal_shows_criteria_and_causes(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    done = called("validate", recorded.PIECE.parent, "--out", tmp_path, "--workers", 1)
    assert "1 of 1 flights, 4 s, beside crazyflie21_room" in done.out
    assert "position after 0.1 s / constant velocity" in " ".join(done.out.split())
    told = json.loads((tmp_path / "validate.json").read_text())
    assert all(cause in " ".join(done.out.split()) for cause in told["causes"])


@pytest.mark.slow
def test_the_flights_that_were_recorded_pass(tmp_path):
    every = recorded.flights()
    told, _ = validate(every[0].parent, tmp_path)
    assert told["flights"] == len(every)
    out = {one["name"] for one in told["left_out"]}
    assert out >= {"B6_linear_ramp_rep1", "B7_oval_slow_rep1"} & {path.stem for path in every}
    assert told["passed"], told["causes"]
