"""An interrupt at any place of a campaign loses no row that is on the disk."""

import pytest

from sim.campaign import run as campaign
from sim.campaign.rows import Row, RowsFile, read_rows

RUNS = 4
AT_ROW = 2  # its interrupt


def landed(seed):
    return Row(seed, "landed", "on the pad", simulated_s=1.0)


def interrupted(monkeypatch, *, written):
    """The interrupt comes just before or just after a row gets to the disk."""
    add = RowsFile.add

    def add_then_interrupt(self, rows):
        last = rows[-1].seed == AT_ROW
        if written or not last:
            add(self, rows)
        if last:
            raise KeyboardInterrupt

    monkeypatch.setattr(RowsFile, "add", add_then_interrupt)


@pytest.mark.parametrize("written", [True, False])
def test_rows_on_the_disk_are_kept(monkeypatch, tmp_path, written):
    monkeypatch.setattr(campaign, "_rows", lambda wanted, todo, workers, cluster: map(landed, todo))
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
