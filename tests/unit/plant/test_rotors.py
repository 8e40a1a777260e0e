"""Tests rotors, ground effect, battery and gusts against formulas, and statistics of the sensors."""

import itertools
import math
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flightstack.compiled.records import new
from sim.chance import stream
from sim.plant.params import load
from sim.plant.rotors import GroundRecord, ground_effect, set_up_ground, thrust_increase
from sim.plant.sensors import NS, MeasurementChannel
from sim.plant.states import rotation_axes
from sim.scenarios.tables import OdometryLink

PARAMS = load()
ROTOR = PARAMS.rotor


LEVEL = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def ground(gain=1.0, pad_radius_m=0.1):
    return set_up_ground(new(GroundRecord), ROTOR, gain, pad_radius_m)


def factors(g, ex, ey, ez, axes=LEVEL):
    """Return the ground-effect factors of the four thrusts, above a pad at a height of 0.2 m."""
    out = np.empty(4)
    ground_effect(g, ex, ey, ez, 0.2, axes, out)
    return out.tolist()


def test_ground_effect_is_clipped_fades_out_and_never_jumps():
    assert thrust_increase(ground(), 0.005) == thrust_increase(ground(), 0.020)
    assert thrust_increase(ground(), 4.0 * ROTOR.radius_m) == 0.0
    values = [thrust_increase(ground(), 0.001 * k / 10.0) for k in range(1200)]
    assert max(abs(a - b) for a, b in itertools.pairwise(values)) < 1e-3
    assert all(a >= b for a, b in itertools.pairwise(values))


def test_at_the_edge_only_the_rotors_over_the_pad_gain_and_far_away_none():
    front_right, rear_right, rear_left, front_left = factors(ground(), 0.1, 0.0, 0.0144)
    assert rear_right == rear_left > 1.03
    assert front_right == front_left == 1.0
    assert factors(ground(), 0.0, 0.0, 0.5) == factors(ground(), 1.0, 0.0, 0.1) == [1.0] * 4


def test_a_tilted_vehicle_feels_every_rotor_at_its_own_height():
    angle = math.radians(10.0)
    axes = rotation_axes((math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))  # attitude with the nose down
    front = 0.04 + ROTOR.above_com_m * math.cos(angle) - ROTOR.arm_m * math.sin(angle)
    rear = front + 2.0 * ROTOR.arm_m * math.sin(angle)
    closed = [1.0 / (1.0 - (ROTOR.radius_m / (4.0 * h)) ** 2) for h in (front, rear, rear, front)]
    assert factors(ground(1.0, 0.5), 0.0, 0.0, 0.04, axes) == pytest.approx(closed, rel=1e-12)


MS = NS // 1000


def run_channel(link, seconds, sigmas=(0.0,), seed=1, step_ms=1):
    """Return all (released_ns, measured_ns, values) of a channel polled every step; true value: the time."""
    channel = MeasurementChannel(link, sigmas, seed, "test")
    out = []
    for k in range(0, round(seconds * 1000) + 1, step_ms):
        now = k * MS
        _, rows = channel.run([now], np.full((1, len(sigmas)), now / NS).__getitem__)
        out += [(now, int(row[0]), tuple(row[1:])) for row in rows.tolist()]
    return out


@given(
    st.lists(st.integers(1, 40), max_size=12),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 0.05]),
    st.sampled_from([0.0, 0.027]),
)
def test_many_steps_in_one_call_are_the_same_to_the_last_bit(counts, loss, dropout_every_s, delay_s):
    link = OdometryLink(70.0, loss=loss, delay_s=delay_s, dropout_every_s=dropout_every_s, dropout_max_s=0.03)
    sigmas = (0.0, 0.01, 0.0, 0.2)
    wanted = run_channel(link, sum(counts) / 100.0, sigmas, step_ms=10)
    channel, out, k = MeasurementChannel(link, sigmas, 1, "test"), [], 0
    for count in (1, *counts):
        times_ns = [10 * MS * n for n in range(k, k + count)]
        values = np.array([[now / NS] * len(sigmas) for now in times_ns])
        at, rows = channel.run(times_ns, values.__getitem__)
        out += [(times_ns[n], int(row[0]), tuple(row[1:])) for n, row in zip(at, rows.tolist(), strict=True)]
        k += count
    assert out == wanted


def test_a_plain_seed_is_numpys_generator():
    mine, plain = stream(5, "wind"), np.random.default_rng(np.random.SeedSequence([5, zlib.crc32(b"wind")]))
    assert np.array_equal(mine.standard_normal(100), plain.standard_normal(100))
    assert mine.uniform(1.0, 2.0) == plain.uniform(1.0, 2.0)
