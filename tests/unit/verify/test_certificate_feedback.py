"""What is proven of the fed-back loop, against the code that flies and a plant with a delay."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from flightstack.verify.certificate import checks, problems
from flightstack.verify.feedback import decay_1_s, linear
from sim.scenarios.scenario import load
from tests.unit.core.strategies.feedback_helpers import BASE, FEEDBACK, fed_back, flown
from tests.unit.verify.certificate_helpers import config, one

STORM = load("storm").onboard


@given(share=st.floats(0.0, 1.0))
@settings(max_examples=25, deadline=None)
def test_every_vehicle_of_the_spread_comes_to_rest_at_least_as_fast_as_proven(share):
    settings_ = fed_back()
    slower, faster = 1.0 / 1.3, 1.0 / 0.7
    proven, _ = decay_1_s(settings_, slower, faster)
    assert proven > 0.3
    path = np.abs(flown(settings_, slower + share * (faster - slower), np.zeros(1400), start_m=0.05))
    early, late = path[200:500].max(), path[1000:1300].max()  # 8 s later
    assert late <= early * np.exp(-8.0 * proven) + 1e-12


@pytest.mark.parametrize("factor", [1.0 / 1.3, 1.0, 1.2])
def test_the_matrix_is_the_loop_that_flies(factor):
    """The first second and a half of the way back, with the code's own ticks."""
    settings_ = fed_back()
    period_s = 1.0 / settings_.loop.rate_hz
    state, step = np.zeros(8), expm(linear(settings_, factor) * period_s)
    state[0] = 0.05
    path = []
    for _ in range(150):
        state = step @ state
        path.append(state[0])
    assert np.abs(flown(settings_, factor, np.zeros(150), start_m=0.05) - path).max() < 0.1 * 0.05


def test_a_vehicle_may_differ_in_rate_and_damping_on_their_own():
    a, b = linear(STORM, 1.1), linear(STORM, 1.1, 1.1)
    assert (a == b).all()
    assert np.flatnonzero(np.any(linear(STORM, 1.1, 0.9) != a, axis=1)).tolist() == [2]


@given(st.floats(0.6, 1.0), st.floats(1.0, 1.6), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_no_vehicle_within_decays_slower_than_proven(low, high, stiff, damped):
    """Rate and damping on their own, too, where they are near each other: the rectangles are."""
    proven, _ = decay_1_s(STORM, low, high)
    factor = low + stiff * (high - low)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor)).real.max())
    near = factor + 1e-3 * (damped - 0.5)
    assert proven <= max(0.0, -np.linalg.eigvals(linear(STORM, factor, near)).real.max())


def test_the_checks_are_there_with_feedback_alone():
    assert one("velocity feedback", **BASE).proven
    assert one("velocity feedback, spread", **BASE).proven
    names = {check.name for check in checks(config())}
    assert "position loop" in names
    assert not any(name.startswith("velocity feedback") for name in names)
    with_it = {check.name for check in checks(fed_back())}
    assert "position loop" not in with_it


def test_a_loop_that_swings_with_a_quicker_vehicle_is_not_proven_but_may_fly():
    hard = {"velocity_feedback": {**FEEDBACK, "error_rate_1_s": 9.0}}
    found = one("velocity feedback, spread", **{**BASE, **hard})
    assert not found.proven
    assert found.remedy
    assert one("velocity feedback", **{**BASE, **hard}).proven
    assert not [text for text in problems(config(**{**BASE, **hard})) if "velocity feedback" in text]


@pytest.mark.parametrize(
    "wrong",
    [
        {"velocity_feedback": {**FEEDBACK, "error_rate_1_s": 20.0, "tilt_rate_1_s": 30.0}},
        {"loop": {"rate_hz": 20}},
        {"own": {"delay_s": 0.15}},
    ],
)
def test_a_loop_that_swings_by_itself_must_not_fly(wrong):
    refused = problems(config(**{**BASE, **wrong}))
    assert any(text.startswith("velocity feedback:") for text in refused)
