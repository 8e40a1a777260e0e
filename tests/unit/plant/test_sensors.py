"""Tests statistics, order and determinism of the measurement channel and of the IMU."""

import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sim.chance import stream
from sim.plant.sensors import NS, MeasurementChannel
from sim.scenarios.tables import OdometryLink

MS = NS // 1000


def run_channel(link, seconds, sigmas=(0.0,), seed=1, step_ms=1):
    """Return all (released_ns, measured_ns, values) of a channel polled every step; true value: the time."""
    channel = MeasurementChannel(link, sigmas, seed, "test")
    out = []
    for k in range(0, round(seconds * 1000) + 1, step_ms):
        now = k * MS
        if now >= channel.due_ns:
            channel.sample(now, [now / NS] * len(sigmas))
        if now >= channel.release_ns:
            out += [(now, t, v) for t, v in channel.release(now)]
    return channel, out


@given(
    st.lists(st.integers(1, 40), max_size=12),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 0.05]),
    st.sampled_from([0.0, 0.027]),
)
def test_many_steps_in_one_call_are_the_same_to_the_last_bit(counts, loss, dropout_every_s, delay_s):
    link = OdometryLink(70.0, loss=loss, delay_s=delay_s, dropout_every_s=dropout_every_s, dropout_max_s=0.03)
    sigmas = (0.0, 0.01, 0.0, 0.2)
    one, wanted = run_channel(link, sum(counts) / 100.0, sigmas, step_ms=10)
    channel, out, k = MeasurementChannel(link, sigmas, 1, "test"), [], 0
    for count in (1, *counts):
        times_ns = [10 * MS * n for n in range(k, k + count)]
        values = np.array([[now / NS] * len(sigmas) for now in times_ns])
        at, rows = channel.run(times_ns, values)
        out += [(times_ns[n], int(row[0]), tuple(row[1:])) for n, row in zip(at, rows.tolist(), strict=True)]
        k += count
    assert out == wanted
    assert (channel.taken, channel.lost, channel.due_ns, channel.release_ns) == (
        one.taken, one.lost, one.due_ns, one.release_ns,
    )  # fmt: skip


def test_a_plain_seed_is_numpys_generator():
    mine, plain = stream(5, "wind"), np.random.default_rng(np.random.SeedSequence([5, zlib.crc32(b"wind")]))
    assert np.array_equal(mine.standard_normal(100), plain.standard_normal(100))
    assert mine.uniform(1.0, 2.0) == plain.uniform(1.0, 2.0)
