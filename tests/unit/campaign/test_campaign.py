"""Tests counts, bounds and limits of a campaign; unknown results count as failures."""

import codecs
import contextlib
import io
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy  # loads scipy.special at the first use

from sim.campaign import run as campaign
from sim.campaign.rows import (
    CELL_M,
    E_Z_LOW_M,
    Row,
    RowsError,
    _cells,
    appending,
    cell_map,
    error_row,
    read_rows,
    write_rows,
)
from sim.campaign.summary import count, summary, upper_bound
from tests.benchmarks.tiers import Tier, misses

GOOD = Row(
    0, "landed", "rests on the pad", False, True, 0.0, 0.03, 0.2, 0.4, 0.008, 0.2, 0.05, 5.0, 0, 3.0, 1.0,
    1.0, 0.0, 0.0, 0.0, 0.01, 0.03, 8.0, 0.2, "",
)  # fmt: skip
CRASHED = replace(GOOD, outcome="crashed", reason="contact before touchdown: ground", time_to_land_s=None)
ABORTED = replace(GOOD, outcome="aborted", reason="declared abort", time_to_land_s=None)
TIMEOUT = replace(GOOD, outcome="timeout", reason="no contact", time_to_land_s=None)
KEYS = [
    "runs", "landed", "declared_aborts", "undeclared_misses", "crashes", "violations",
    "upper_95_violation_rate", "h_min_outside_pad_m", "touchdown_error_m", "touchdown_speed_vertical_m_s",
    "touchdown_speed_horizontal_m_s", "time_to_land_s", "outside_envelope", "judged_apart", "wall_s",
    "realtime_factor", "worst",
]  # fmt: skip


def numbered(*rows):
    return [replace(row, seed=seed) for seed, row in enumerate(rows)]


@pytest.mark.parametrize("runs", [1, 2, 10, 500, 10_000])
@pytest.mark.parametrize("events", [0, 1, 2, 7, 400])
def test_upper_bound_is_clopper_pearsons(events, runs):
    if events > runs:
        with pytest.raises(ValueError, match=f"{events} events in {runs} runs"):
            upper_bound(events, runs)
        return
    bound = upper_bound(events, runs)
    assert (
        bound == 1.0
        if events == runs
        else scipy.special.bdtr(events, runs, bound) == pytest.approx(0.05, rel=1e-9)
    )


def test_every_row_is_counted_once():
    rows = numbered(GOOD, GOOD, CRASHED, ABORTED, TIMEOUT, error_row(5, "x"))
    counts = count(rows)
    # the row with outcome error counts as a violation, because a violation may have occurred
    assert list(counts.items()) == [
        ("runs", 6),
        ("landed", 2),
        ("declared_aborts", 1),
        ("undeclared_misses", 2),
        ("crashes", 1),
        ("violations", 1),
    ]


def test_summary_has_the_promised_keys_and_numbers():
    errors = [0.01, 0.02, 0.03, 0.04, 0.05]
    rows = numbered(*[replace(GOOD, touchdown_error_m=e, time_to_land_s=100 * e) for e in errors], CRASHED)
    told = summary(rows, "fly {seed}", wall_s=2.0, flown_s=80.0)
    assert list(told) == KEYS
    assert told["touchdown_error_m"] == {"median": pytest.approx(0.03), "p95": pytest.approx(0.048)}
    assert told["time_to_land_s"] == {"median": pytest.approx(3.0)}
    assert told["realtime_factor"] == 40.0
    assert told["h_min_outside_pad_m"] == 0.03
    assert told["worst"][0] == {
        "seed": 5, "why": "crashed: contact before touchdown: ground", "command": "fly 5"
    }  # fmt: skip
    assert told["worst"][1]["seed"] == 4


PAPER = [replace(GOOD, time_to_land_s=4.5)]


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (CRASHED, "crashes: 1 of 1000"),
        (TIMEOUT, "misses nobody declared: 1 of 1000"),
        (replace(GOOD, violation=True), "violations: 1 of 1000"),
        (replace(GOOD, violation=None), "violations: 1 of 1000"),
        (error_row(0, "died"), "misses nobody declared"),
    ],
)
def test_one_bad_row_in_a_thousand_misses_lab(bad, said):
    found = misses(Tier.LAB, [bad] + [GOOD] * 999, PAPER)
    assert any(said in text for text in found)


@pytest.mark.parametrize(
    ("tier", "aborts"), [(Tier.LAB, 1), (Tier.ROOM, 5), (Tier.FIELD, 5), (Tier.STORM, 30), (Tier.DECK, 5)]
)
def test_declared_aborts_are_allowed_up_to_the_share(tier, aborts):
    assert misses(tier, [ABORTED] * aborts + [GOOD] * (1000 - aborts), PAPER) == []
    found = misses(tier, [ABORTED] * (aborts + 1) + [GOOD] * (999 - aborts), PAPER)
    assert [text.split(":")[0] for text in found] == ["landed"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"touchdown_error_m": 0.0251}, "touchdown error, 95 %"),
        ({"touchdown_speed_vertical_m_s": 0.26}, "vertical"),
        ({"touchdown_speed_horizontal_m_s": 0.11}, "horizontal"),
    ],
)
def test_tails_are_limited(change, said):
    found = misses(Tier.LAB, [replace(GOOD, **change)] * 60 + [GOOD] * 940, PAPER)
    assert len(found) == 1
    assert said in found[0]


def test_slower_than_the_paper_by_more_than_a_quarter_is_a_miss():
    assert misses(Tier.LAB, [GOOD], [replace(GOOD, time_to_land_s=4.01)]) == []
    assert "median time" in misses(Tier.LAB, [GOOD], [replace(GOOD, time_to_land_s=3.99)])[0]


FULL = Row(
    7, "landed", 'touched, "quoted",\nnext line', False, True, -0.1 / 3, 0.1 + 0.2, 1.0, 0.3, 0.01, 0.2, 0.03,
    5.123456789012345, 2, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.01, 0.03, 8.0, 0.25, "0 3 -4;1 3 10",
    "landed crashed", 1, 2, 0.1 + 0.7, 0.1 / 3, 0.7 / 3,
)  # fmt: skip


def test_rows_read_back_the_same_to_the_last_bit(tmp_path):
    rows = [FULL, error_row(3, "ended\nits worker"), replace(FULL, seed=1, violation=None)]
    write_rows(tmp_path / "rows.csv", rows)
    assert read_rows(tmp_path / "rows.csv") == sorted(rows, key=lambda r: r.seed)


def test_appended_rows_survive_and_a_cut_line_is_dropped(tmp_path):
    path = tmp_path / "rows.csv"
    with appending(path) as add:
        add(FULL)
        add(replace(FULL, seed=8, reason="plain"))
    whole = path.read_bytes()
    for cut in range(1, 40):
        path.write_bytes(whole[:-cut])
        assert [r.seed for r in read_rows(path)] == [7]
        with appending(path) as add:
            add(replace(FULL, seed=9, reason="plain"))
        assert [r.seed for r in read_rows(path)] == [7, 9]


class Growing(io.StringIO):
    """File to which a campaign appends: one read ends within a line, the next returns the line's rest."""

    def __init__(self, text, first):
        super().__init__(text[:first])
        self.rest = text[first:]

    def readline(self, size=-1):
        line = super().readline(size)
        if not line.endswith("\n"):
            at = self.tell()
            self.seek(0, io.SEEK_END)
            self.write(self.rest)
            self.seek(at)
        return line


@pytest.mark.parametrize("first", [0, 20, "first row", "second row"])
def test_a_file_that_grows_while_it_is_read_gives_its_whole_first_rows(tmp_path, monkeypatch, first):
    path, rows = tmp_path / "rows.csv", [replace(FULL, seed=seed, reason="plain") for seed in (1, 2)]
    write_rows(path, rows)
    with path.open(newline="", encoding="utf-8") as file:
        head, one, _ = file.readlines()
    starts = {"first row": len(head) + 10, "second row": len(head) + len(one) + 10}
    growing = Growing(path.read_bytes().decode(), starts.get(first, first))
    monkeypatch.setattr(type(path), "open", lambda *arguments, **options: growing)
    assert read_rows(path) == (rows[:1] if first == "second row" else [])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"0.25", b"quarter"), (b"false", b"maybe"), (b",5.12", b",,5.12"), (b"0.25", b"nan"),
        (b"0.25", b"-1e999"), (b"landed", b"nan"), (b"plain", b"\xff"),
    ],
)  # fmt: skip
def test_a_damaged_line_is_refused_with_its_number(tmp_path, old, new):
    path = tmp_path / "rows.csv"
    write_rows(path, [replace(FULL, reason="plain")])
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new))
    with pytest.raises(RowsError, match="line 2"):
        read_rows(path)


def test_rows_in_utf_16_are_refused_with_what_to_do(tmp_path):
    path = tmp_path / "rows.csv"
    write_rows(path, [FULL])
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-16")
    with pytest.raises(RowsError, match="UTF-16 or another encoding; save it as UTF-8"):
        read_rows(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b"\r\n", b"\n"),
        lambda data: codecs.BOM_UTF8 + data,
        lambda data: data + data[data.index(b"\n") + 1 :],
    ],
    ids=["LF", "BOM", "twice"],
)
def test_rows_that_an_editor_or_git_has_stored_are_read(tmp_path, change):
    path = tmp_path / "rows.csv"
    write_rows(path, [FULL])
    path.write_bytes(change(path.read_bytes()))
    assert read_rows(path) == [FULL]


def test_cells_keep_the_lowest_h_of_each():
    d_m = np.array([0.05, 0.07, 0.15, 99.0])
    e_z_m = np.array([0.02, 0.03, -5.0, 99.0])
    text = _cells(d_m, e_z_m, np.array([0.010, -0.0204, 0.3, 1.0]))
    lowest_m, visits = cell_map([replace(FULL, cells=text), replace(FULL, cells="0 3 -50")])
    level = math.floor((0.02 - E_Z_LOW_M) / CELL_M)
    assert lowest_m[level, 0] == pytest.approx(-0.050)
    assert visits[level, 0] == 2
    assert lowest_m[0, 1] == pytest.approx(0.3)  # values below the map are in the lowest cells
    assert lowest_m[-1, -1] == pytest.approx(1.0)
    assert visits.sum() == 4
    assert np.isnan(lowest_m[5, 5])


RUNS = 4
AT_ROW = 2  # number of the row at which the campaign is interrupted


def landed(seed):
    return Row(seed, "landed", "on the pad", simulated_s=1.0)


def interrupted(monkeypatch, *, written):
    @contextlib.contextmanager
    def appending_until(path):
        with appending(path) as add:

            def add_then_interrupt(row):
                if written or row.seed != AT_ROW:
                    add(row)
                if row.seed == AT_ROW:
                    raise KeyboardInterrupt

            yield add_then_interrupt

    monkeypatch.setattr(campaign, "appending", appending_until)


@pytest.mark.parametrize("written", [True, False])
def test_rows_on_the_disk_are_kept(monkeypatch, tmp_path, written):
    monkeypatch.setattr(campaign, "_rows", lambda wanted, todo, workers, cluster: map(landed, todo))
    monkeypatch.setattr(campaign, "warm_up", lambda scenario: None)
    wanted = campaign.plan("straight", RUNS, 0, None)
    with monkeypatch.context() as patch:
        interrupted(patch, written=written)
        flown = campaign.fly(wanted, tmp_path, workers=1, cluster=None, on_row=lambda row: None)
    kept = [row.seed for row in read_rows(tmp_path / campaign.ROWS)]
    assert kept == [row.seed for row in flown.rows] == list(range(AT_ROW + written))
    assert flown.missing == RUNS - len(kept)
    flown = campaign.fly(wanted, tmp_path, workers=1, cluster=None, on_row=lambda row: None)
    assert [row.seed for row in flown.rows] == list(range(RUNS))
    assert flown.missing == 0


def test_the_wall_time_of_a_campaign_does_not_include_compilation(monkeypatch, tmp_path):
    clock_s = [0.0]

    def wait(*_, seconds=20.0):
        clock_s[0] += seconds

    def rows(wanted, todo, workers, cluster):
        wait(seconds=2.0)
        yield from (replace(GOOD, seed=seed, simulated_s=8.0) for seed in todo)

    monkeypatch.setattr(campaign, "time", SimpleNamespace(monotonic=lambda: clock_s[0]))
    monkeypatch.setattr(campaign, "warm_up", wait)
    monkeypatch.setattr(campaign, "_rows", rows)
    wanted = campaign.plan("lab", 2, 0, None)
    flown = campaign.fly(wanted, tmp_path, workers=1, cluster=None, on_row=lambda row: None)
    assert (flown.summary["wall_s"], flown.summary["realtime_factor"]) == (2.0, 8.0)
