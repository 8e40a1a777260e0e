"""Errors of an estimate: what was put in is found again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.validation.sensing import BANDS_HZ, Trace, analyse

STEP_S = 0.01


def path(t, speed=0.6):
    """Return position and velocity on a circle of 1 m radius."""
    angle = speed * t
    position = np.stack([np.cos(angle), np.sin(angle), 1.0 + 0.0 * t], axis=1)
    velocity = speed * np.stack([-np.sin(angle), np.cos(angle), 0.0 * t], axis=1)
    return position, velocity


def trace(seconds, delay_s=0.0, offset=(0.0, 0.0, 0.0), noise=None, speed=0.6):
    t = np.arange(0.0, seconds, STEP_S)
    truth, velocity = path(t, speed)
    late, _ = path(t - delay_s, speed)
    estimate = late + np.array(offset) + (0.0 if noise is None else noise(t, velocity))
    return Trace(STEP_S, truth, estimate, np.linalg.norm(velocity[:, :2], axis=1))


@settings(max_examples=25, deadline=None)
@given(
    delay_s=st.floats(-0.08, 0.15),
    offset=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    speed=st.floats(0.3, 1.2),
)
def test_delay_and_offset_are_found(delay_s, offset, speed):
    found = analyse([trace(20.0, delay_s, offset, speed=speed), trace(10.0, delay_s, offset, speed=speed)])
    assert found.delay_s == pytest.approx(delay_s, abs=2e-3)
    assert found.offset == pytest.approx(offset, abs=2e-3)
    assert max(found.rms) < 2e-3


def test_a_delay_that_varies_is_an_error_along_the_motion():
    chance = np.random.default_rng(3)

    def jitter(t, velocity):
        return -velocity * chance.normal(0.0, 0.02, len(t))[:, None]

    found = analyse([trace(60.0, 0.02, noise=jitter)])
    assert found.along == pytest.approx(0.6 * 0.02, rel=0.1)
    assert found.across < 0.1 * found.along
    assert found.by_speed[1] == pytest.approx(0.012, rel=0.1)
    assert np.isnan(found.by_speed[3])


def test_the_correlation_time_is_that_of_the_noise():
    chance = np.random.default_rng(5)

    def coloured(t, velocity):
        del velocity
        kept, values = np.exp(-STEP_S / 0.2), np.zeros((len(t), 3))
        for i in range(1, len(t)):
            values[i] = kept * values[i - 1] + np.sqrt(1.0 - kept**2) * chance.normal(0.0, 0.01, 3)
        return values

    found = analyse([trace(300.0, noise=coloured)])
    assert found.correlation_s == pytest.approx(0.2, rel=0.25)
    assert found.rms == pytest.approx((0.01, 0.01, 0.01), rel=0.15)
    assert sum(found.spectrum) == pytest.approx(1.0)
    assert found.spectrum[0] > found.spectrum[-1]


def test_white_noise_is_spread_over_the_bands_by_their_width():
    chance = np.random.default_rng(7)
    found = analyse([trace(300.0, noise=lambda t, _: chance.normal(0.0, 0.01, (len(t), 3)))])
    shares = [(high - low) / 50.0 for low, high in BANDS_HZ]
    assert found.spectrum == pytest.approx(shares, abs=0.03)
    assert found.correlation_s == pytest.approx(STEP_S)


def test_nothing_to_compare_is_refused():
    with pytest.raises(ValueError, match="no pieces"):
        analyse([])
