"""Tests that simulated errors of the state estimate are like recorded errors, also by default."""

import numpy as np
import pytest

from flightstack.compiled.records import cell, new
from sim.flights.recording import Recording
from sim.flights.screening import Screened, load
from sim.plant.state_error import ErrorRows, PastRecord, mismeasured_path
from sim.scenarios.tables import StateError
from sim.validation.sensing import compare
from tests.recorded import flights

pytestmark = pytest.mark.slow

PUT_IN = StateError(
    delay_s=0.04, delay_spread_s=0.01, delay_fast_s=0.015, delay_fast_varies=0.2, delay_slow_s=0.012,
    delay_slow_time_s=0.5, delay_slow_varies=0.0, velocity_lead_s=0.01, velocity_along=0.05,
    velocity_scale=0.04, velocity_across=0.03, velocity_error_m_s=0.01, velocity_z_m_s=0.01,
)  # fmt: skip


def made(seed, error, seconds=30.0):
    """Return a flight on figures of eight at 0.2 to 1 m/s, with estimates from the error model."""
    t = np.arange(0.0, seconds, 0.01)
    rng = np.random.default_rng(seed)
    pace = rng.uniform(0.4, 1.0)
    position = np.stack([np.sin(pace * t), 0.4 * np.sin(2.0 * pace * t), 1.0 + 0.0 * t], axis=1)
    velocity = np.gradient(position, t, axis=0)
    past, states = new(PastRecord), np.empty((len(t), 6))
    past.rate = 100.0
    rows = ErrorRows(error, seed, "own", 100.0).take(len(t))
    mismeasured_path(cell(past), position, velocity, rows, states)
    upright, none = np.tile((1.0, 0.0, 0.0, 0.0), (len(t), 1)), np.zeros((len(t), 4))
    recording = Recording(
        f"made {seed}", t, position, velocity, upright, none[:, :3], none, none[:, 0] + 3.7,
        estimate_position_m=states[:, :3], estimate_velocity_m_s=states[:, 3:],
    )  # fmt: skip
    return Screened(recording, (slice(0, len(t)),), ())


def pooled(found, quantity):
    """Return the ratio of simulated to recorded errors by speed band, and the difference of delays, s."""
    pairs = [(getattr(each.simulated, quantity), getattr(each.recorded, quantity)) for each in found]
    sizes = np.sqrt(np.nanmean(np.square([[e.by_speed for e in pair] for pair in pairs]), axis=0))
    return sizes[0] / sizes[1], np.mean([a.delay_s - b.delay_s for a, b in pairs])


def test_simulated_estimates_are_like_those_that_the_same_model_made():
    found = [compare(made(seed, PUT_IN), 1000 + seed, PUT_IN) for seed in range(12)]
    for quantity in ("position", "velocity"):
        ratio, delay_s = pooled(found, quantity)
        assert ratio[:3] == pytest.approx(np.ones(3), abs=0.25), quantity
        assert abs(delay_s) < 0.008
    other = [compare(made(seed, PUT_IN), 1000 + seed, StateError(delay_fast_s=0.06)) for seed in range(4)]
    assert np.all(pooled(other, "position")[0][:3] > 1.5)


def test_the_defaults_are_like_the_recorded_flights():
    """Default errors have 65 to 135 % of the size of recorded errors, and the same delay within 12 ms."""
    recorded = [load(path) for path in flights()[::3]]
    found = [compare(flight, number) for number, flight in enumerate(recorded) if flight.usable]
    for quantity in ("position", "velocity"):
        ratio, delay_s = pooled([each for each in found if each is not None], quantity)
        assert ratio == pytest.approx(np.ones(len(ratio)), abs=0.35), quantity
        assert abs(delay_s) < 0.012
