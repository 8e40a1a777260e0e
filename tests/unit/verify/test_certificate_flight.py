"""Tests claims of the certificate in flight, with real control law and filter, under the worst errors."""

import math
import random
from dataclasses import replace

import pytest

from flightstack.core.parameters.filters import FILTERS
from flightstack.core.safety.barrier import RobustBarrier
from flightstack.core.safety.position_loop import nominal_velocity
from flightstack.core.safety.qp_filter import SafetyFilter
from flightstack.core.snapshot import Relative
from flightstack.core.strategies.packaged.robust import RobustFilter
from flightstack.core.target.track import TargetState
from flightstack.core.types import ZERO, OwnState
from flightstack.verify.certificate import problems
from flightstack.verify.envelope import extremes
from flightstack.verify.robust import depth_m
from flightstack.verify.touchdown import drift_m
from sim.scenarios import scenario
from tests.unit.verify.certificate_helpers import config
from tests.unit.verify.certificate_page import split, tables

pytestmark = pytest.mark.slow

DT_S = 0.01


class Wanderer:
    """Target with changing commands; its speed and acceleration are within the declared limits."""

    def __init__(self, rng, x):
        self.rng, self.x = rng, x
        self.position, self.left_s = [0.0, 0.0, 0.0], 0.0
        heading, speed = rng.uniform(0.0, math.tau), rng.choice((0.0, x.target_speed_m_s))
        self.velocity = [speed * math.cos(heading), speed * math.sin(heading), 0.0]
        self.aim = self.velocity

    def move(self):
        rng, x = self.rng, self.x
        self.left_s -= DT_S
        if self.left_s <= 0.0:
            self.left_s = rng.uniform(0.2, 1.5)
            heading, speed = rng.uniform(0.0, math.tau), rng.choice((0.0, 1.0)) * x.target_speed_m_s
            climb = rng.choice((-1.0, 0.0, 1.0)) * x.target_climb_m_s
            self.aim = [speed * math.cos(heading), speed * math.sin(heading), climb]
        for axes, most in (((0, 1), x.target_acceleration_m_s2), ((2,), x.heave_acceleration_m_s2)):
            missing = math.hypot(*(self.aim[i] - self.velocity[i] for i in axes))
            share = min(1.0, most * DT_S / missing) if missing > 0.0 else 0.0
            for i in axes:
                self.velocity[i] += share * (self.aim[i] - self.velocity[i])
        for i in range(3):
            self.position[i] += self.velocity[i] * DT_S


def fly(settings, seed, seconds=8.0):
    """Fly one approach with the real control law and filter; return the lowest true h outside the pad, m.

    The vertical velocity differs from its command by at most the declared tracking error, the horizontal
    velocity lags, and the relative position has a constant error of the declared size.
    """
    rng, x = random.Random(seed), extremes(settings)
    robust, most = settings.robust, settings.limits.velocity_max_m_s
    law, program = RobustFilter(settings, x.barrier), SafetyFilter(robust.rate_1_s)
    target = Wanderer(rng, x)
    side, angle, d = rng.uniform(0.0, math.tau), rng.uniform(0.0, math.tau), rng.uniform(0.3, 2.5)
    size, up = rng.choice((0.0, 1.0, 1.0)) * x.position_error_m, rng.uniform(-1.0, 1.0)
    level = size * math.sqrt(1.0 - up * up)
    bias = (level * math.cos(side), level * math.sin(side), up * size * x.height_error_m / x.position_error_m)
    sigma_m, sigma_z_m = (
        math.sqrt((error_m / robust.sigma_factor) ** 2 - settings.own.position_noise_m**2)
        for error_m in (x.position_error_m, x.height_error_m)
    )
    flat = (d * math.cos(angle), d * math.sin(angle))
    held = RobustBarrier(x.barrier, x.usual.margin_m.low, robust.fade_radius_m)
    clear = -held.h((flat[0] + bias[0], flat[1] + bias[1], bias[2])) + rng.choice((0.0, 0.05, 0.4))
    position, velocity, before = [*flat, clear], [0.0, 0.0, 0.0], ZERO
    step = [a * DT_S for a in robust.acceleration_max_m_s2]
    lowest, error = math.inf, 0.0
    for tick in range(int(seconds / DT_S)):
        e = tuple(p - q for p, q in zip(position, target.position, strict=True))
        if math.hypot(e[0], e[1]) > x.pad_radius_m:
            lowest = min(lowest, x.barrier.h(e))
        seen_e = tuple(p + b for p, b in zip(e, bias, strict=True))
        own = OwnState(0.0, 0.0, tuple(position), tuple(velocity), 0.0)
        state = TargetState(0.0, tuple(target.position), tuple(target.velocity), 0.0, sigma_m, sigma_z_m)
        seen = Relative(own, state, seen_e, math.hypot(*seen_e[:2]))
        h, gradient, dh_dt = law.barrier(seen).evaluate(seen_e, state.velocity_enu_m_s)
        lower = [max(-m, b - s) for m, b, s in zip(most, before, step, strict=True)]
        upper = [min(m, b + s) for m, b, s in zip(most, before, step, strict=True)]
        climb = law.climb_m_s(h, gradient, before, seen)
        lower[2] = max(lower[2], min(climb, upper[2]))
        gain = robust.gain_1_s
        above = (seen_e[0], seen_e[1], seen_e[2] - robust.wait_height_m)
        nominal = nominal_velocity(above, (gain, gain, gain), state.velocity_enu_m_s)
        before = program.solve(nominal, h, gradient, dh_dt, tuple(lower), tuple(upper)).velocity_enu_m_s
        if tick % 20 == 0:
            error = rng.choice((-1.0, 0.0, 1.0, 1.0)) * robust.tracking_error_m_s
        for i in range(2):
            velocity[i] += (before[i] - velocity[i]) * DT_S / (0.3 * settings.velocity_loop.lag_xy_s)
        velocity[2] = before[2] - error
        for i in range(3):
            position[i] += velocity[i] * DT_S
        target.move()
    return lowest


SETS = {
    "plain": {},
    "heaving": {"envelope": {"target_climb_max_m_s": 0.2}},
    "coarse": {"own": {"position_noise_m": 0.006}, "robust": {"tracking_error_m_s": 0.06}},
    "driving on a floor": {"target": {"jerk_z_m_s3_sqrthz": 0.02}, "own": {"position_noise_m": 0.001}},
    "lazy": {"robust": {"rate_1_s": 0.7, "fade_radius_m": 0.04}},
}


@pytest.mark.parametrize("name", SETS)
def test_h_stays_above_what_is_promised_outside_the_pad(name):
    settings = config(**SETS[name])
    depth, _ = depth_m(settings, extremes(settings))
    lowest = min(fly(settings, seed) for seed in range(12))
    assert lowest >= -depth
    assert lowest < extremes(settings).usual.margin_m.low  # one of the flights used part of the margin


@pytest.mark.parametrize("acceleration", [0.0, 0.5, 1.5])
def test_no_descent_drifts_farther_than_promised(acceleration):
    """Simulate the motion above the pad with errors of the worst size in nearly the worst direction."""
    settings = config(envelope={"target_acceleration_max_m_s2": acceleration})
    x = extremes(settings)
    promised, _ = drift_m(settings, x)
    gain, told = settings.robust.gain_over_pad_1_s, settings.velocity_loop.lag_xy_s
    dt = 0.002
    farthest = 0.0
    for seed in range(60):
        rng = random.Random(seed)
        lag = rng.choice((x.lag_xy_s, told, 2.0 * told - x.lag_xy_s, rng.uniform(0.7, 1.3) * told))
        turn = rng.uniform(0.0, math.tau)
        start = settings.robust.commit_radius_m + x.position_error_m
        e = [start * math.cos(turn), start * math.sin(turn)]
        slip = settings.robust.commit_speed_m_s
        heading = turn if rng.random() < 0.7 else rng.uniform(0.0, math.tau)
        w = [slip * math.cos(heading), slip * math.sin(heading)]  # velocity relative to that of the target
        aside = rng.uniform(-0.5, 0.5) if seed % 3 else 0.0
        for _ in range(500):
            away = math.atan2(e[1], e[0]) + aside
            unit = (math.cos(away), math.sin(away))
            wrong_v = [x.velocity_error_m_s * u for u in unit]
            wrong_p = [-x.position_error_m * u for u in unit]
            a = [-x.target_acceleration_m_s2 * u for u in unit]
            for i in range(2):
                wanted = wrong_v[i] - gain * (e[i] + wrong_p[i])  # commanded velocity relative to the target
                rate = a[i] - gain * w[i]  # rate of the commanded velocity, world frame
                pulled = (wanted - w[i] + told * rate) / lag - a[i]
                w[i] += pulled * dt
                e[i] += w[i] * dt
            farthest = max(farthest, math.hypot(*e))
    assert farthest <= promised
    assert farthest > 0.65 * promised  # the promised limit is not far too large


@pytest.mark.parametrize("name", ["worked", "verdicts", "fleet"])
def test_the_tables_are_the_codes(name):
    page, table = tables()[name]
    _, within, _ = split(page.read_text(), name)
    assert within == table, "run: python -m tests.unit.verify.certificate_page"


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("name", scenario.names())
def test_no_shipped_scenario_is_refused_with_either_filter(name, kind):
    assert problems(replace(scenario.load(name).onboard, filter=kind)) == []
