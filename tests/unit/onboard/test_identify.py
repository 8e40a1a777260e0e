"""Tests that ``identify`` finds the parameters of a synthetic vehicle, and rejects flights without them."""

import math

import numpy as np
import pytest

from flightstack.identify import Segment, identify, link

DT_S = 0.01


def made_up(
    seed, *, gain=1.0, rate=5.2, damping=0.68, dead_s=0.0, seconds=20.0, size=0.4, wind=0.0, noisy=0.005
):
    """Return velocity commands with steps, and the response of a synthetic vehicle.

    The response is integrated here; the model that ``fit`` uses is not called.
    """
    from scipy import signal  # a late import: it takes half a second

    rng = np.random.default_rng(seed)
    n, fine = int(seconds / DT_S), 10
    command = np.repeat(rng.uniform(-size, size, n // 40 + 1), 40)[:n]
    delayed = np.concatenate([np.zeros(round(dead_s / DT_S * fine)), np.repeat(command, fine)])[: n * fine]
    h = DT_S / fine  # Euler's method: dv += h (rate^2 (gain u - v) - 2 damping rate dv), v += h dv
    kept, pulled = 1.0 - 2.0 * damping * rate * h, (h * rate) ** 2
    v = signal.lfilter([pulled * gain], [1.0, pulled - 1.0 - kept, kept], delayed)
    flown = np.concatenate([[0.0], v[fine - 1 :: fine]])[:n]
    slow = signal.lfilter([DT_S / 1.5], [1.0, DT_S / 1.5 - 1.0], rng.normal(0.0, wind * math.sqrt(150.0), n))
    return Segment(command, flown + slow + 0.1 + rng.normal(0.0, noisy, n))


@pytest.mark.parametrize(
    "truth",
    [
        {"rate": 5.2, "damping": 0.68, "dead_s": 0.0},
        {"rate": 8.0, "damping": 0.68, "dead_s": 0.02},
        {"rate": 4.0, "damping": 0.9, "dead_s": 0.05, "gain": 0.9},
        {"rate": 2.4, "damping": 0.6, "dead_s": 0.25, "gain": 1.3},
        {"rate": 4.0, "damping": 0.6, "dead_s": 0.4},
    ],
)
def test_known_parameters_are_found(truth):
    found = identify([made_up(1, **truth)], DT_S, "x")
    lag = 2.0 * truth["damping"] / truth["rate"] + truth["dead_s"]
    assert found.lag_s == pytest.approx(lag, rel=0.04)
    assert found.rate_1_s == pytest.approx(truth["rate"], rel=0.05)
    assert found.damping == pytest.approx(truth["damping"], abs=0.05)
    assert found.dead_time_s == pytest.approx(truth["dead_s"], abs=0.01)
    assert found.gain == pytest.approx(truth.get("gain", 1.0), rel=0.03)
    assert found.model_dead_time_s == (found.dead_time_s if truth["dead_s"] > 0.1 else 0.0)
    assert found.model_rate_1_s == pytest.approx(
        2.0 * found.damping / (found.lag_s - found.model_dead_time_s)
    )
    assert found.explained > 0.97


def test_a_short_flight_is_refused():
    with pytest.raises(ValueError, match="fly longer"):
        identify([made_up(1, seconds=1.9)], DT_S, "vertically")
    with pytest.raises(ValueError, match="found 0"):
        identify([], DT_S, "vertically")


def test_a_quiet_flight_is_refused():
    with pytest.raises(ValueError, match="fly behind a target"):
        identify([made_up(1, size=0.02)], DT_S, "x")


def test_a_flight_that_the_commands_do_not_explain_is_refused():
    one, other = made_up(1), made_up(2)
    with pytest.raises(ValueError, match=r"explains .* less wind"):
        identify([Segment(one.command_m_s, other.velocity_m_s)], DT_S, "x")


def samples(seed, *, rate_hz=50.0, position=0.01, velocity=0.03, lost=0.05, delay=0.06, seconds=30.0):
    """Return measurements of a target that drives on a circle of 0.5 m radius at 0.4 m/s and heaves."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    t = t[rng.random(len(t)) >= lost]
    turn = 0.8 * t
    p = np.column_stack((0.5 * np.cos(turn), 0.5 * np.sin(turn), 0.1 * np.sin(1.5 * t)))
    v = np.column_stack((np.full(len(t), 0.4), np.zeros(len(t)), 0.15 * np.cos(1.5 * t)))
    return (
        t,
        t + delay + rng.exponential(0.004, len(t)),
        p + rng.normal(0.0, position, p.shape),
        v + rng.normal(0.0, velocity, v.shape),
    )


def test_noise_rate_loss_and_delay_of_a_link_are_found():
    found = link(*samples(3))
    assert found.position_noise_m == pytest.approx(0.01, rel=0.1)
    assert found.velocity_noise_m_s == pytest.approx(0.03, rel=0.1)
    assert found.rate_hz == pytest.approx(50.0, rel=1e-6)
    assert found.loss == pytest.approx(0.05, abs=0.02)
    assert found.delay_s == pytest.approx(0.06, abs=0.001)
    assert found.delay_spread_s == pytest.approx(0.012, abs=0.004)


@pytest.mark.slow
def test_its_standard_errors_are_true():
    """In 19 or more of 24 windy flights the lag is within two standard errors; these match the spread."""
    lag = 2.0 * 0.68 / 5.2
    found = [identify([made_up(seed, wind=0.05)], DT_S, "x") for seed in range(24)]
    missed = [abs(one.lag_s - lag) / one.errors[4] for one in found]
    assert sum(m < 2.0 for m in missed) >= 19
    spread = np.std([one.lag_s for one in found])
    assert 0.4 * spread < np.mean([one.errors[4] for one in found]) < 2.5 * spread
