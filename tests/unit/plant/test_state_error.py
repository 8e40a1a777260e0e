"""Tests errors of state estimates: correlated noise, positive and negative delays, random parameters."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.compiled.records import new
from sim.plant.state_error import (
    AHEAD,
    ASIDE,
    DELAY,
    POSITION,
    STILL_AHEAD,
    STILL_ASIDE,
    VELOCITY,
    VELOCITY_DELAY,
    WIDTH,
    ErrorRows,
    PastRecord,
    mismeasure,
)
from sim.scenarios.tables import StateError

RATE_HZ = 100.0
FINE = StateError(
    delay_s=0.0, delay_spread_s=0.0, delay_fast_s=0.0, delay_slow_s=0.0, velocity_lead_s=0.0,
    velocity_lead_spread_s=0.0, position_error_m=0.0, velocity_error_m_s=0.0, velocity_z_m_s=0.0,
    velocity_scale=0.0, velocity_along=0.0, velocity_across=0.0, tilt_rad=0.0, yaw_rad=0.0,
    tilt_noise_rad=0.0, yaw_noise_rad=0.0,
)  # fmt: skip


def drawn(spec, seed=1, count=400, purpose="own"):
    return ErrorRows(spec, seed, purpose, RATE_HZ).take(count)


@given(parts=st.lists(st.integers(1, 90), min_size=1, max_size=6), seed=st.integers(0, 2**64 - 1))
def test_rows_do_not_depend_on_how_many_are_taken_at_once(parts, seed):
    rows = ErrorRows(StateError(), seed, "own", RATE_HZ)
    taken = np.concatenate([rows.take(count) for count in parts])
    assert np.array_equal(taken, drawn(StateError(), seed, sum(parts)))


def measured(row, truth, *, samples=60, rate_hz=RATE_HZ):
    """Return the position and velocity that the error model reports for the last sample on a path."""
    past = new(PastRecord)
    past.rate = rate_hz
    for k in range(samples):
        position, velocity = truth(k / rate_hz)
        mismeasure(past, np.array(position), np.array(velocity), row)
    return past.late[:3].copy(), past.late[3:].copy()


COLUMNS = {
    "delay": DELAY, "velocity_delay": VELOCITY_DELAY, "ahead": AHEAD, "aside": ASIDE,
    "still_ahead": STILL_AHEAD, "still_aside": STILL_ASIDE,
}  # fmt: skip


def row_of(**parts):
    row = np.zeros(WIDTH)
    for name, value in parts.items():
        row[COLUMNS[name]] = value
    return row


def circle(t_s):
    return (math.cos(t_s), math.sin(t_s), 0.3 * t_s), (-math.sin(t_s), math.cos(t_s), 0.3)


@given(delay_s=st.floats(0.0, 0.2), velocity_delay_s=st.floats(0.0, 0.2))
def test_a_late_state_is_that_of_the_path(delay_s, velocity_delay_s):
    position, velocity = measured(row_of(delay=delay_s, velocity_delay=velocity_delay_s), circle)
    assert position == pytest.approx(circle(0.59 - delay_s)[0], abs=2e-5)  # tolerance of linear interpolation
    assert velocity == pytest.approx(circle(0.59 - velocity_delay_s)[1], abs=2e-5)


@given(lead_s=st.floats(0.0, 0.1))
def test_a_state_ahead_goes_on_as_it_went(lead_s):
    position, velocity = measured(row_of(delay=-lead_s, velocity_delay=-lead_s), circle)
    now, speed = circle(0.59)
    assert position == pytest.approx(np.array(now) + lead_s * np.array(speed), abs=1e-12)
    assert velocity == pytest.approx(2.0 * np.array(speed) - circle(0.59 - lead_s)[1], abs=2e-5)


def test_errors_of_the_velocity_turn_with_it_and_others_do_not():
    _, velocity = measured(row_of(ahead=0.1, aside=0.05), lambda _: ((0.0, 0.0, 0.0), (2.0, 0.0, 1.0)))
    assert velocity == pytest.approx((2.2, 0.1, 1.0))
    _, velocity = measured(row_of(ahead=0.1, aside=0.05), lambda _: ((0.0, 0.0, 0.0), (0.0, -2.0, 0.0)))
    assert velocity == pytest.approx((0.1, -2.2, 0.0))
    still = row_of(still_ahead=0.01, still_aside=0.02)
    _, velocity = measured(still, lambda _: ((0.0, 0.0, 0.0), (0.0, -2.0, 0.0)))
    assert velocity == pytest.approx((0.02, -2.01, 0.0))
    _, velocity = measured(still, lambda _: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert velocity == pytest.approx((0.01, 0.02, 0.0))
    row = np.zeros(WIDTH)
    row[POSITION : POSITION + 3], row[VELOCITY : VELOCITY + 3] = (0.01, 0.02, 0.03), (0.1, 0.2, 0.3)
    position, velocity = measured(row, lambda _: ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
    assert position == pytest.approx((1.01, 1.02, 1.03))
    assert velocity == pytest.approx((0.1, 0.2, 0.3))
