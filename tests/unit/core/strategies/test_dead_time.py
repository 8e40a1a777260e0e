"""Tests the filter with a velocity loop that has a dead time: prediction, state, rejections, proof."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from flightstack.common.strict_toml import ConfigError
from flightstack.config import load as load_config
from flightstack.core.controller import Controller
from flightstack.core.parameters.robust import VelocityLoop
from flightstack.core.strategies.velocity_tracking import VelocityTracking
from flightstack.verify.certificate import checks
from flightstack.verify.late import tick_matrix
from tests.point_mass import World
from tests.unit.core.core_helpers import config

LOOP = {"lag_xy_s": 0.75, "dead_time_s": 0.25, "rate_xy_1_s": 2.4, "damping": 0.6}
LATE = {
    "velocity_loop": {**LOOP, "gain_xy": 0.2},
    "checks": {"follow_lag_max_s": 1.0, "follow_memory_s": 2.0},
}


def test_the_way_until_a_set_point_acts_is_the_way_that_the_modelled_vehicle_flies():
    tracking, period_s = VelocityTracking(VelocityLoop(**LOOP), 0.01), 0.01
    rng = np.random.default_rng(0)
    told = [(*rng.uniform(-0.5, 0.5, 2), 0.0) for _ in range(80)]
    flown, foretold = [(0.1, -0.2, 0.0)], []
    tracking.observe(flown[0], commanding=False)
    for setpoint in told:
        foretold.append(tracking.carried(flown[-1]))
        tracking.memory.setpoint_m_s = setpoint
        tracking.observe(flown[-1], commanding=True)
        flown.append(tracking.memory.model_m_s)  # the vehicle moves exactly like the model
    late = 25
    for k, (way_m, then_m_s) in enumerate(foretold[:-late]):
        assert then_m_s[:2] == pytest.approx(flown[k + late][:2], abs=1e-12)
        passed = np.sum(flown[k + 1 : k + late + 1], axis=0) * period_s
        assert way_m == pytest.approx(passed[:2], abs=1e-12)


def test_without_a_dead_time_nothing_is_under_way():
    tracking = VelocityTracking(VelocityLoop(), 0.01)
    assert tracking.carried((0.1, 0.2, 0.3)) == ((0.0, 0.0), (0.1, 0.2, 0.3))
    assert tracking.late.sent_m_s == ()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"velocity_loop": {**LOOP, "lag_xy_s": 0.25}}, "velocity_loop.lag_xy_s"),
        ({"velocity_feedback": {"horizontal": True}}, "velocity_feedback.horizontal"),
        ({"own": {"velocity_error_m_s": 0.02}}, "own.velocity_error_m_s"),
    ],
)
def test_it_is_refused_where_a_part_does_not_know_of_it(changes, named):
    with pytest.raises(ConfigError, match=rf"velocity_loop.dead_time_s: found 0.25.*{named}"):
        config(**{**LATE, **changes})


@pytest.mark.parametrize(
    ("changes", "keys"),
    [
        ({"checks": {"target_age_max_s": 0.03}}, ("checks.target_age_max_s", "envelope.target_rate_hz")),
        (
            {"checks": {"own_age_max_s": 0.04}, "loop": {"rate_hz": 20}},
            ("checks.own_age_max_s", "loop.rate_hz"),
        ),
        ({"checks": {"follow_lag_max_s": 0.2}}, ("checks.follow_lag_max_s", "velocity_loop.lag_xy_s")),
    ],
)
def test_limits_that_contradict_each_other_are_named(changes, keys):
    with pytest.raises(ConfigError) as caught:
        config(**changes)
    for key in keys:
        assert key in str(caught.value)


def missing(settings):
    return [check.name for check in checks(settings) if not check.proven]


def test_the_certificate_refuses_the_loop_that_swings_and_proves_the_configuration_made_for_it():
    shipped = load_config("ardupilot-1kg")
    assert missing(shipped) == missing(load_config("ardupilot47-1kg")) == []
    for loop in ({"dead_time_s": 0.25, "damping": 0.6}, LOOP):
        late = replace(shipped, velocity_loop=replace(shipped.velocity_loop, **loop))
        assert missing(late) == ["lead, spread"]


def test_a_simulated_step_is_the_matrix():
    """From 1 m, the closed loop of the certificate's tick matrix comes to rest within 1 cm of the target."""
    settings = load_config("ardupilot47-1kg")
    matrix = tick_matrix(settings, 0.8, 1.0, 1.0)
    state = np.zeros(len(matrix))
    state[0] = 1.0
    way = [float((state := matrix @ state)[0]) for _ in range(1500)]
    assert min(way) > -0.35  # the overshoot is less than 35 %
    assert abs(way[-1]) < 0.01
    assert all(w == 1.0 for w in way[:25])  # the vehicle does not move during the dead time


def test_a_restored_flight_goes_on_to_the_bit():
    world = World(config(**LATE))
    for _ in range(300):
        world.step()
    again = Controller(config(**LATE))
    again.restore(deepcopy(world.controller.state))
    assert len(set(again.strategy.late.sent_m_s)) > 1
    for _ in range(60):
        inputs, now_s = world.inputs(), world.t_s
        mine, theirs = again.step(inputs, now_s), world.step()
        assert mine.setpoint.velocity_enu_m_s == theirs.setpoint.velocity_enu_m_s
        assert again.strategy.late == world.controller.strategy.late
