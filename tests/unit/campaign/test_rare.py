"""Subset simulation with known rates, and its folder."""

import json
import math
from dataclasses import replace
from statistics import NormalDist

import pytest

from sim.campaign import rare
from sim.campaign.rare import Event, Rare, estimate, score
from sim.campaign.rows import error_row, read_rows
from sim.campaign.run import plan
from sim.chance import stream
from tests.unit.campaign.test_campaign import ABORTED, CRASHED, GOOD, TIMEOUT

PAD_M = 0.1


def beyond(beta):
    """Return the probability that a standard normal number exceeds beta."""
    return NormalDist().cdf(-beta)


def distances(beta, numbers=30):
    """Return scores of landings that fail if a sum of random numbers, itself standard normal, exceeds
    beta."""

    def scores(seeds):
        return [
            beta - float(stream(seed, "x").standard_normal(numbers).sum()) / math.sqrt(numbers)
            for seed in seeds
        ]

    return scores


@pytest.mark.parametrize(("beta", "number"), [(1.0, 200), (1.645, 200), (3.1, 300)])
def test_the_interval_holds_the_true_rate_as_often_as_it_says(beta, number):
    true, found = beyond(beta), [estimate(distances(beta), number, seed) for seed in range(20)]
    assert sum(one.low <= true <= one.high for one in found) >= 17
    assert sum(one.rate for one in found) / len(found) == pytest.approx(true, rel=0.3)
    if true > 0.1:  # frequent enough to be counted
        assert all(one.landings == number for one in found)


def test_a_rate_of_a_millionth_takes_some_thousand_landings():
    true = beyond(4.753)
    found = estimate(distances(4.753), 500, 1)
    assert found.low <= true <= found.high
    assert found.landings < 5000
    assert all(0.1 <= level.share < 0.12 for level in found.levels[:-1])
    assert all(0.2 < level.accepted < 0.7 for level in found.levels[1:])
    for begins, ends in zip(found.levels[1:], found.levels, strict=False):
        assert begins.begins_at == ends.ends_at
    scores = distances(4.753)(found.failures)
    assert len(scores) == len(set(found.failures)) > 10
    assert max(scores) <= 0.0


def test_what_never_fails_has_a_bound():
    found = estimate(lambda seeds: [1e9 + distances(0.0)([seed])[0] for seed in seeds], 100, 0)
    assert (found.rate, found.low, found.failures) == (0.0, 0.0, ())
    assert 0.0 < found.high < 1e-8


@pytest.mark.parametrize(
    ("event", "row", "expected"),
    [
        (Event.VIOLATION, GOOD, 0.035),
        (Event.VIOLATION, replace(GOOD, violation=True, h_min_outside_pad_m=-0.02), 0.0),
        (Event.VIOLATION, replace(GOOD, violation=None, h_min_outside_pad_m=None), 0.0),  # cannot be excluded
        (Event.VIOLATION, replace(GOOD, h_min_outside_pad_m=-0.3, started_safe=False), 1e-9),
        (Event.VIOLATION, replace(ABORTED, h_min_outside_pad_m=None), PAD_M),
        (Event.MISS, GOOD, 0.092),
        (Event.MISS, replace(ABORTED, touchdown_error_m=None), PAD_M),
        (Event.MISS, CRASHED, 0.0),
        (Event.MISS, TIMEOUT, 0.0),
        (Event.MISS, replace(ABORTED, touchdown_error_m=0.2), 0.0),
    ],
)
def test_the_score_is_the_distance_to_the_failure(event, row, expected):
    assert score(event, row, PAD_M) == pytest.approx(expected)


def test_a_landing_that_could_not_be_flown_ends_the_estimate():
    with pytest.raises(RuntimeError, match="seed 7 could not be flown: no disk"):
        score(Event.MISS, error_row(7, "no disk"), PAD_M)


class Workers:
    """A landing computed by arithmetic."""

    flown = 0
    at_most = math.inf

    def __init__(self, *_):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def fly(self, seeds):
        for seed in seeds:
            if Workers.flown >= Workers.at_most:
                raise KeyboardInterrupt
            Workers.flown += 1
            h_m = 0.01 * distances(2.0)([seed])[0] - 0.005
            yield replace(GOOD, seed=seed, h_min_outside_pad_m=h_m, violation=h_m < -0.005)


@pytest.fixture
def arithmetic(monkeypatch):
    monkeypatch.setattr(rare, "Workers", Workers)
    monkeypatch.setattr(rare, "warm_up", lambda _: None)
    monkeypatch.setattr(Workers, "flown", 0)
    return Workers


def fly(folder, event=Event.VIOLATION, runs=100, seed=3):
    return rare.fly(Rare(plan("lab", runs, seed, None), event), folder, workers=1, on_row=lambda row: None)


def test_an_interrupted_estimate_goes_on_and_comes_to_the_same(arithmetic, monkeypatch, tmp_path):
    whole = fly(tmp_path / "whole")
    assert whole["interval_95"][0] <= beyond(2.0) <= whole["interval_95"][1]
    assert arithmetic.flown == whole["landings"] == len(read_rows(tmp_path / "whole" / "rows.csv"))
    monkeypatch.setattr(arithmetic, "at_most", arithmetic.flown + 130)
    with pytest.raises(KeyboardInterrupt):
        fly(tmp_path / "parts")
    monkeypatch.setattr(arithmetic, "at_most", math.inf)
    parts = fly(tmp_path / "parts")
    assert arithmetic.flown == 2 * whole["landings"]
    assert json.dumps(parts).replace("parts", "whole") == json.dumps(whole)
    assert json.loads((tmp_path / "parts" / "summary.json").read_text()) == parts


def test_the_failures_are_files_that_the_command_names(arithmetic, tmp_path):
    told = fly(tmp_path)
    assert len(told["failures"]) == min(rare.FAILURES_KEPT, len(list((tmp_path / "failures").iterdir())))
    for number, one in enumerate(told["failures"]):
        file = tmp_path / "failures" / f"{number}.seed"
        assert f"--seed {file} " in one["command"]
        assert distances(2.0)([int(file.read_text())])[0] <= 0.0
        assert "violation h down to" in one["why"]
