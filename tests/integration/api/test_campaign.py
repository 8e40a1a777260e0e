"""Campaigns and sweeps of the library."""

import subprocess
import sys

import pytest

import flightstack as fs
from flightstack.common.strict_toml import ConfigError


def local():
    class Slower(fs.Filter):
        def filter(self, nominal, at):
            return 0.5 * nominal

    return Slower


def test_a_campaign_is_a_table_and_equals_single_landings():
    result = fs.campaign("lab", seeds=[7, 1], filter=local(), workers=2)
    assert result.table["seed"].tolist() == [1, 7]
    for row in result.rows:
        verdict = fs.land("lab", row.seed, filter=local()).verdict
        assert (row.outcome, row.violation, row.h_min_m) == (
            verdict.outcome,
            verdict.violation,
            verdict.h_min_m,
        )
    assert len(result) == 2
    assert repr(result).startswith("Campaign(lab: ")
    assert len(repr(result)) < 100


SCRIPT = """
import threading
import flightstack as fs
ends = threading.Event()
threading.Thread(target=ends.wait).start()
class Slower(fs.Filter):
    def filter(self, nominal, at):
        return 0.5 * nominal
print(fs.campaign("lab", seeds=[1], filter=Slower).rows[0].violation)
ends.set()
"""


def test_a_script_with_threads_needs_no_guard(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["True"]


def test_a_sweep_judges_by_the_barrier_that_flew():
    grid = {"barrier.alpha_1_m": [1.0, 1.3], "wind.mean_m_s": [0]}
    sweep = fs.sweep("lab", grid, seeds=[3], filter="paper", workers=1)
    assert sweep.table["barrier.alpha_1_m"].tolist() == [1.0, 1.3]
    for (alpha_1_m, _), campaign in sweep.points:
        (member,) = campaign.scenario.member
        assert member.judged_by.alpha_1_m == member.onboard.barrier.build().alpha_1_m == alpha_1_m
    assert [point["landed"] for point in sweep.rates()] == [1.0, 1.0]
    assert len(sweep.plot().data) == 2


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda: fs.sweep("lab", {}), "a key and values"),
        (lambda: fs.sweep("lab", {"wind.mean": [1]}), "the key is mean_m_s"),
        (lambda: fs.campaign("lab", seeds=[]), "whole numbers"),
        (lambda: fs.campaign("nothing"), "neither a file nor one of"),
    ],
)
def test_bad_input_is_named(wrong, text):
    with pytest.raises(ConfigError, match=text):
        wrong()
