"""Tests the criteria and the summary of a comparison with recorded flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.flights.screening import Reason
from sim.options import ValidateOptions
from sim.validation import closed_loop, open_loop, sensing
from sim.validation.criteria import causes, judge, over_flights, summary
from sim.validation.run import Compared
from tests.examples import examples

PLAN = ValidateOptions(folder=Path("flights"))
FLOWN = closed_loop.Flown(0.1, 0.02, 0.85, 0.05)
ERROR = sensing.Error(0.02, (0.002, 0.01, 0.014, 0.025))


def horizon(seconds, position=0.35, velocity=0.4):
    """Return errors at a horizon; ``position``, ``velocity``: model error over that of constant velocity."""
    return open_loop.Horizon(
        seconds,
        open_loop.Compared(position * 0.02, 0.02, 0.9 * 0.02),
        open_loop.Compared(velocity * 0.15, 0.15, 0.9 * 0.15),
        open_loop.Compared(0.02, 0.04, 0.03),
    )


def flight(name="a", *, thrust=1.01, flown=FLOWN, simulated=FLOWN, recorded=ERROR, sensed=ERROR, worse=1.0):
    horizons = tuple(horizon(seconds, 0.35 * worse, 0.4 * worse) for seconds in (0.1, 0.25, 0.5))
    return Compared(
        name, 20.0, (),
        open_loop.OpenLoop(horizons=horizons, thrust_ratio=thrust, starts=200),
        closed_loop.ClosedLoop(thrust=1.0, recorded=flown, simulated=simulated),
        sensing.Sensing(sensing.Errors(recorded, recorded), sensing.Errors(sensed, sensed)),
    )  # fmt: skip


def missed(*flights):
    return {verdict.criterion.text for verdict in judge(flights) if not verdict.met}


def test_flights_that_the_simulator_flies_pass():
    assert missed(*(flight(name) for name in "abcde")) == set()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"thrust": 1.1}, "thrust, plant / recording"),
        ({"thrust": 0.9}, "thrust, plant / recording"),
        ({"simulated": replace(FLOWN, duty=0.88)}, "PWM in hover, median difference"),
        ({"simulated": replace(FLOWN, saturated=0.11)}, "saturated time / recorded"),
        ({"simulated": replace(FLOWN, horizontal_m=0.07)}, "flights with tracking within 25 %"),
        ({"sensed": replace(ERROR, delay_s=0.03)}, "delay of position - recorded"),
        (
            {"sensed": replace(ERROR, by_speed=(0.002, 0.01, 0.018, 0.025))},
            "position at 0.65 to 0.85 m/s / recorded",
        ),
    ],
)
def test_each_part_can_fail_alone(change, text):
    found = missed(*(flight(name, **change) for name in "abcde"))
    assert text in found
    assert {t.replace("velocity", "position") for t in found} == {text}


def test_a_model_that_does_not_know_the_commands_is_missed_at_every_horizon():
    found = missed(*(flight(name, worse=2.6) for name in "abc"))
    assert {
        f"{q} after {h:g} s / constant velocity" for q in ("position", "velocity") for h in (0.1, 0.25, 0.5)
    } < found
    assert "position after 0.1 s / ideal body" in found


def test_wrong_thrust_is_the_first_cause_and_named():
    told = causes(judge([flight(name, thrust=1.1, worse=2.0) for name in "abc"]))
    assert told[0] == "the plant's thrust is 1.10 times the recorded one"
    assert told[1].startswith("the recorded motor commands do not move the plant as they moved the vehicle: ")
    assert "position after 0.1 s / constant velocity: 0.7 " in told[1]
    assert "limit ≤ 0.5" in told[1]


def test_a_part_that_no_flight_covers_is_missed():
    verdicts = judge([replace(flight(name), sensing=None) for name in "ab"])
    judged = [v for v in verdicts if v.criterion.part == "sensing"]
    assert all((v.met, v.text) == (False, "no flight covers it") for v in judged)
    (cause,) = causes(verdicts)
    assert cause.startswith("sensing is not judged by any flight: ")


def test_chance_explains_some_of_a_difference_and_not_more():
    """Recorded errors span a factor of 3; simulated errors above them by 1.33 are open, by 6 are missed."""

    def word(factor):
        sizes = np.geomspace(0.006, 0.018, 8)
        errors = [replace(ERROR, by_speed=(0.002, size, 0.014, 0.025)) for size in sizes]
        large = [replace(ERROR, by_speed=(0.002, factor * size, 0.014, 0.025)) for size in sizes[::-1]]
        flights = [
            flight(str(i), recorded=a, sensed=b) for i, (a, b) in enumerate(zip(errors, large, strict=True))
        ]
        found = {v.criterion.text: v.word for v in judge(flights)}
        return found["position at 0.35 to 0.65 m/s / recorded"]

    assert [word(factor) for factor in (1.1, 1.33, 6.0)] == ["met", "open", "missed"]


def test_the_summary_is_json_and_counts_every_flight_once():
    out = Compared("bad", 0.0, (Reason("in the air for 0.0 s only", 3.0),))
    cut = replace(flight("cut"), left_out=(Reason("values missing (NaN)", 1.23),))
    slow = replace(ERROR, by_speed=(0.002, float("nan"), 0.01, 0.02))
    flights = [out, cut, flight("good", sensed=slow)]
    told = msgspec.json.decode(msgspec.json.encode(summary(PLAN, flights, judge(flights))))
    assert told["flights"] == told["used"] + len(told["left_out"]) == 3
    assert told["left_out"] == [{"name": "bad", "reasons": ["in the air for 0.0 s only"]}]
    assert told["cut"] == [{"name": "cut", "reasons": ["values missing (NaN) (1.2 s)"]}]
    assert told["passed"]
    assert told["causes"] == []


@examples(30)
@given(values=st.lists(st.floats(0.01, 100.0), min_size=2, max_size=20))
def test_an_interval_holds_the_median_and_lies_within_the_flights(values):
    found = over_flights(np.median, [*values, float("nan")])
    ordered = [min(values), found.low, found.value, found.high, max(values)]
    assert ordered == pytest.approx(sorted(ordered), rel=1e-12)
    assert over_flights(np.median, values) == found
