"""Measurement channel and IMU: statistics, order, determinism."""

import itertools
import math
import statistics
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.chance import MOVE_SEED_MAX, MOVES_MAX, fresh, moved, name, stream
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


N = 40_000


def walk(weight, moves, begin=7):
    seed = fresh(begin)
    for n in range(moves):
        seed = moved(seed, 1000 + n, weight)
    return seed


def test_a_plain_seed_is_numpys_generator():
    mine, plain = stream(5, "wind"), np.random.default_rng(np.random.SeedSequence([5, zlib.crc32(b"wind")]))
    assert np.array_equal(mine.standard_normal(100), plain.standard_normal(100))
    assert mine.uniform(1.0, 2.0) == plain.uniform(1.0, 2.0)


@pytest.mark.parametrize("moves", [0, 1, 9])
@pytest.mark.parametrize("weight", [0.05, 0.5])
def test_each_distribution_stays_itself_whatever_the_moves(weight, moves):
    from scipy import stats  # a late import: it takes half a second

    seed = walk(weight, moves)
    assert stats.kstest(stream(seed, "a").standard_normal(N), "norm").pvalue > 1e-3
    assert stats.kstest(stream(seed, "b").random(N), "uniform").pvalue > 1e-3
    assert stats.kstest(stream(seed, "c").uniform(-2.0, 4.0, N), "uniform", (-2.0, 6.0)).pvalue > 1e-3
    waits = stream(seed, "d")
    assert stats.kstest([waits.exponential(3.0) for _ in range(2000)], "expon", (0.0, 3.0)).pvalue > 1e-3
    dice = stream(seed, "e")
    counts = np.bincount([int(dice.integers(6)) for _ in range(6000)], minlength=6)
    assert stats.chisquare(counts).pvalue > 1e-3
    rows = [dice.integers((2, 5)).tolist() for _ in range(500)]
    assert {a for a, _ in rows} == {0, 1}
    assert {b for _, b in rows} == set(range(5))
    picked = np.bincount([dice.choice(3, p=(0.5, 0.3, 0.2)) for _ in range(3000)], minlength=3)
    assert stats.chisquare(picked, (1500, 900, 600)).pvalue > 1e-3
    one, two = (child.standard_normal(N) for child in dice.spawn(2))
    assert stats.kstest(one, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.02
    assert sorted(stream(seed, "f").permutation(50).tolist()) == list(range(50))


@pytest.mark.parametrize("weight", [0.125, 0.5])
def test_a_move_is_as_far_as_its_weight_says(weight):
    before, after = walk(weight, 3), walk(weight, 4)
    a, b = stream(before, "x").standard_normal(N), stream(after, "x").standard_normal(N)
    assert np.corrcoef(a, b)[0, 1] == pytest.approx(math.sqrt(1.0 - weight**2), abs=0.02)


@given(st.lists(st.tuples(st.integers(1, MOVE_SEED_MAX), st.integers(1, 255)), max_size=6))
def test_the_same_number_is_the_same_chance(moves):
    seed = fresh(3)
    for move_seed, w in moves:
        seed = moved(seed, move_seed, w / 256)
    assert int(str(seed)) == seed
    assert len(name(seed)) < 30
    numbers = stream(seed, "x").standard_normal(3)
    # by the formula, one move after the other
    z = np.random.default_rng(np.random.SeedSequence([3, zlib.crc32(b"x")])).standard_normal(3)
    for move_seed, w in moves:
        fresh_z = np.random.default_rng(
            np.random.SeedSequence([move_seed, zlib.crc32(b"x")])
        ).standard_normal(3)
        z = w / 256 * fresh_z + math.sqrt(1.0 - (w / 256) ** 2) * z
    assert numbers == pytest.approx(z, abs=1e-12)


def test_what_is_not_allowed_is_refused():
    for bad in (0, MOVE_SEED_MAX + 1):
        with pytest.raises(ValueError, match="seed of a move"):
            fresh(bad)
    for weight in (0.0, -0.1, 1.1, math.nan):
        with pytest.raises(ValueError, match="weight"):
            moved(fresh(1), 2, weight)
    with pytest.raises(ValueError, match="has no moves"):
        moved(17, 2, 0.5)
    seed = walk(0.5, MOVES_MAX - 1)
    with pytest.raises(ValueError, match="moves already"):
        moved(seed, 5, 0.5)
    assert moved(seed, 5, 1.0) == fresh(5)
