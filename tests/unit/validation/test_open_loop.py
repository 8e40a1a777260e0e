"""Tests flights of the simulated vehicle with recorded motor commands of simulated and real flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.flights.screening import screen
from sim.plant.params import load
from sim.validation.open_loop import HORIZONS_S, commanded_rpm, compare
from sim.validation.sensing import analyse
from tests.examples import examples
from tests.unit.validation.test_closed_loop import AIRFRAME, recorded

ROOM = load("crazyflie21_room")


def with_thrust(factor):
    rotor = ROOM.rotor
    return replace(
        ROOM,
        rotor=replace(
            rotor,
            thrust_linear_n_rpm=factor * rotor.thrust_linear_n_rpm,
            thrust_square_n_rpm2=factor * rotor.thrust_square_n_rpm2,
        ),
    )


def test_the_plant_flies_its_own_flight():
    found = compare(screen(recorded(AIRFRAME)), ROOM)
    assert found is not None
    assert [h.seconds for h in found.horizons] == list(HORIZONS_S)
    assert found.starts > 100
    assert found.thrust_ratio == pytest.approx(1.0 / AIRFRAME.thrust, abs=0.01)
    for horizon in found.horizons:
        for errors in (horizon.position_m, horizon.velocity_m_s):
            assert errors.model < 0.5 * errors.constant_velocity
            assert errors.model < 0.6 * errors.ideal


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_thrust_that_is_off_is_named_and_calibrated(factor):
    flight = screen(recorded(AIRFRAME))
    as_is, off = compare(flight, ROOM), compare(flight, with_thrust(factor))
    assert off.thrust_ratio / as_is.thrust_ratio == pytest.approx(factor, abs=0.005)
    assert off.horizons[2].position_m.model < 2.0 * as_is.horizons[2].position_m.model


def test_commands_in_random_order_predict_badly():
    flight = screen(recorded(AIRFRAME))
    duty = np.random.default_rng(1).permutation(flight.recording.duty)
    as_is = compare(flight, ROOM)
    shuffled = compare(replace(flight, recording=replace(flight.recording, duty=duty)), ROOM)
    for before, after in zip(as_is.horizons, shuffled.horizons, strict=True):
        assert after.velocity_m_s.model > 2.0 * before.velocity_m_s.model
        assert after.position_m.constant_velocity == before.position_m.constant_velocity


def test_a_compensated_motor_gets_the_thrust_that_is_asked_for_until_the_battery_ends_it():
    params = load("crazyflie20")
    half, full = commanded_rpm(params, np.array([[0.5] * 4, [1.0] * 4]), np.array([3.7, 2.8]))
    assert params.rotor.thrust_n(half[0]) == pytest.approx(0.5 * params.rotor.thrust_max_n)
    assert full[0] == params.battery.speed_rpm(2.8)


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
    return truth, estimate, np.linalg.norm(velocity[:, :2], axis=1)


@examples(25)
@given(
    delay_s=st.floats(-0.08, 0.15), offset=st.tuples(*[st.floats(-0.1, 0.1)] * 3), speed=st.floats(0.3, 1.2)
)
def test_delay_is_found_and_offset_is_no_error(delay_s, offset, speed):
    found = analyse(
        STEP_S, [trace(20.0, delay_s, offset, speed=speed), trace(10.0, delay_s, offset, speed=speed)]
    )
    assert found.delay_s == pytest.approx(delay_s, abs=2e-3)
    assert np.nanmax(found.by_speed) < 2e-3


def test_a_delay_that_varies_is_an_error_at_the_flown_speed():
    chance = np.random.default_rng(3)

    def jitter(t, velocity):
        return -velocity * chance.normal(0.0, 0.02, len(t))[:, None]

    found = analyse(STEP_S, [trace(60.0, 0.02, noise=jitter)])
    assert found.by_speed[1] == pytest.approx(0.012, rel=0.1)
    assert np.isnan(found.by_speed[3])
