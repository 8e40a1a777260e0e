"""Measurement channel and IMU: statistics, order, determinism."""

import itertools
import math
import statistics
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.chance import stream
from sim.plant.imu import Imu
from sim.plant.params import CONTROL_STEP_S, load
from sim.plant.sensors import NS, MeasurementChannel
from sim.scenarios.scenario import OdometryLink

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


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0, 30.0])
def test_rate_is_kept_on_average(rate_hz):
    _, out = run_channel(OdometryLink(rate_hz), 20.0)
    assert len(out) == pytest.approx(20.0 * rate_hz + 1, abs=1)


def test_delay_is_exact_and_order_is_kept():
    _, out = run_channel(OdometryLink(100.0, delay_s=0.06), 5.0, step_ms=10)
    assert {released - measured for released, measured, _ in out} == {60 * MS}
    assert [m for _, m, _ in out] == sorted(m for _, m, _ in out)


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


def test_noise_has_its_deviation_and_no_mean():
    _, out = run_channel(OdometryLink(500.0), 20.0, sigmas=(0.002, 0.05))
    for i, sigma in enumerate((0.002, 0.05)):
        errors = [v[i] - t / NS for _, t, v in out]
        assert statistics.pstdev(errors) == pytest.approx(sigma, rel=0.03)
        assert abs(statistics.mean(errors)) < 3 * sigma / math.sqrt(len(errors))


def test_drop_outs_come_and_end():
    link = OdometryLink(100.0, dropout_every_s=2.0, dropout_max_s=0.3)
    _, out = run_channel(link, 200.0, step_ms=10)
    gaps = [(b[1] - a[1]) / NS for a, b in itertools.pairwise(out) if b[1] - a[1] > 15 * MS]
    assert 60 < len(gaps) < 130  # one per 2.15 s on average
    assert max(gaps) <= 0.3 + 0.02
    assert max(gaps) > 0.2


def imu_run(seed, n=20000):
    imu = Imu(load().imu, 9.81, CONTROL_STEP_S, seed)
    imu.settle((0.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    out = []
    for _ in range(n):
        imu.measure((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
        out.append((*imu.gyro, *imu.accel))
    return imu, out


def test_imu_at_rest_feels_gravity_bias_and_filtered_noise():
    imu, out = imu_run(3)
    p = load().imu
    for i in range(3):
        gyro, accel = [o[i] for o in out], [o[3 + i] for o in out]
        # white noise through a first-order filter keeps the one-sided noise bandwidth 1 / (4 tau)
        for values, density, cut in (
            (gyro, p.gyro_noise_rad_s_sqrthz, p.gyro_filter_hz),
            (accel, p.accel_noise_m_s2_sqrthz, p.accel_filter_hz),
        ):
            tau = math.sqrt(2.0) / (2.0 * math.pi * cut)
            assert statistics.pstdev(values) == pytest.approx(density * math.sqrt(0.25 / tau), rel=0.1)
        assert statistics.mean(accel) - (9.81 if i == 2 else 0.0) == pytest.approx(
            imu.accel_bias[i], abs=2e-3
        )
        assert abs(statistics.mean(gyro)) < 4 * p.gyro_bias_rad_s


def test_imu_filter_lags_a_rate_step_by_the_group_delay():
    imu = Imu(load().imu, 9.81, CONTROL_STEP_S, 1)
    imu.settle((0.0, 0.0, 0.0), (0.0, 0.0, 9.81))
    axes = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    lag, rate = 0.0, 5.0
    for _ in range(50):
        imu.measure((0.0, 0.0, 0.0), (rate, 0.0, 0.0), axes)
        lag += CONTROL_STEP_S * (1.0 - imu.gyro[0] / rate)
    assert lag == pytest.approx(math.sqrt(2.0) / (2.0 * math.pi * 80.0), abs=CONTROL_STEP_S)


def test_a_plain_seed_is_numpys_generator():
    mine, plain = stream(5, "wind"), np.random.default_rng(np.random.SeedSequence([5, zlib.crc32(b"wind")]))
    assert np.array_equal(mine.standard_normal(100), plain.standard_normal(100))
    assert mine.uniform(1.0, 2.0) == plain.uniform(1.0, 2.0)
