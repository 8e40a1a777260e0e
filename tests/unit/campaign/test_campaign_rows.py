"""Rows of a campaign and their file: nothing is lost, nothing is rounded, nothing damaged is believed."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from sim.campaign.rows import (
    CELL_M,
    E_Z_LOW_M,
    Row,
    RowsError,
    RowsFile,
    _cells,
    cell_map,
    error_row,
    missing,
    read_rows,
    write_rows,
)

FULL = Row(
    7, "landed", 'touched, "quoted",\nnext line', False, True, -0.1 / 3, 0.1 + 0.2, 1.0, 0.3, 0.01, 0.2, 0.03,
    5.123456789012345, 2, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.01, 0.03, 8.0, 0.25, "0 3 -4;1 3 10",
)  # fmt: skip


def test_rows_read_back_the_same_to_the_last_bit(tmp_path):
    rows = [FULL, error_row(3, "ended\nits worker"), replace(FULL, seed=1, violation=None)]
    write_rows(tmp_path / "rows.csv", rows)
    assert read_rows(tmp_path / "rows.csv") == sorted(rows, key=lambda r: r.seed)


def test_a_row_has_no_untested_field():
    assert all(getattr(FULL, f.name) is not None for f in fields(Row))


def test_appended_rows_survive_and_a_cut_line_is_dropped(tmp_path):
    path = tmp_path / "rows.csv"
    with RowsFile(path) as file:
        file.add([FULL])
        file.add([replace(FULL, seed=8, reason="plain")])
    whole = path.read_bytes()
    for cut in range(1, 40):
        path.write_bytes(whole[:-cut])
        assert [r.seed for r in read_rows(path)] == [7]
        with RowsFile(path) as file:
            file.add([replace(FULL, seed=9, reason="plain")])
        assert [r.seed for r in read_rows(path)] == [7, 9]


@pytest.mark.parametrize(("old", "new"), [(b"0.25", b"quarter"), (b"false", b"maybe"), (b",5.12", b",,5.12")])
def test_a_damaged_line_is_refused_with_its_number(tmp_path, old, new):
    path = tmp_path / "rows.csv"
    write_rows(path, [replace(FULL, reason="plain")])
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))
    with pytest.raises(RowsError, match="line 2"):
        read_rows(path)


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(RowsError, match="first line"):
        read_rows(path)


def test_missing_seeds():
    rows = [replace(FULL, seed=s) for s in (10, 12)]
    assert list(missing(rows, 10, 4)) == [11, 13]


def test_cells_keep_the_lowest_h_of_each():
    d_m = np.array([0.05, 0.07, 0.15, 99.0])
    e_z_m = np.array([0.02, 0.03, -5.0, 99.0])
    text = _cells(d_m, e_z_m, np.array([0.010, -0.0204, 0.3, 1.0]))
    lowest_m, visits = cell_map([replace(FULL, cells=text), replace(FULL, cells="0 3 -50")])
    level = math.floor((0.02 - E_Z_LOW_M) / CELL_M)
    assert lowest_m[level, 0] == pytest.approx(-0.050)
    assert visits[level, 0] == 2
    assert lowest_m[0, 1] == pytest.approx(0.3)  # below the map: in its lowest cells
    assert lowest_m[-1, -1] == pytest.approx(1.0)
    assert visits.sum() == 4
    assert np.isnan(lowest_m[5, 5])
