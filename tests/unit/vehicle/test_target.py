"""Tests the robot: motion, odometry, ticks simulated in advance, and the deck that follows the robot."""

import itertools
import math

import pytest

from bridge.frames import quaternion_from_yaw
from bridge.ros2.cdr import Odometry
from flightstack.common.strict_toml import ConfigError
from sim.robot import DEMANDS, Deck, TargetModel
from sim.runners.published_robot import deck_state, follow
from sim.scenarios.tables import PathKind, TargetSpec

DT = 0.01
FORWARD_AND_TURN = [5, 11]  # indices in a row of the model: speed forward, turn rate


def drive(spec, seed=1, seconds=20.0, driving=True):
    model = TargetModel(spec, seed)
    states = []
    for _ in range(round(seconds / DT)):
        states.append(model.pad)
        model.run(1, DT, driving)
    return model, states


def zigzag(t_s, x_m, y_m, yaw_rad):
    if t_s > 5.0:
        raise ZeroDivisionError("beyond the end")
    return 9.0, math.cos(t_s)


def test_a_function_steers_within_the_limits_and_its_error_says_whose_it_is(monkeypatch):
    monkeypatch.setattr("sim.robot.referred", lambda name, key: zigzag)
    spec = TargetSpec(path=PathKind.FUNCTION, speed_m_s=0.2, turn_rate_rad_s=0.5, function="mine:zigzag")
    _, states = drive(spec, seconds=4.9)
    assert math.hypot(*states[-1].velocity_enu_m_s[:2]) == pytest.approx(0.2)
    with pytest.raises(ConfigError, match=r"mine:zigzag raised ZeroDivisionError: .* at t = 5\.0\d s"):
        drive(spec, seconds=6.0)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        ({"path": PathKind.WAYPOINTS, "speed_m_s": 0.1, "turn_rate_rad_s": 1.0}, "at least 2 are needed"),
        ({"path": PathKind.FIGURE_OF_EIGHT, "speed_m_s": 0.1}, "needs speed_m_s and turn_rate_rad_s"),
        ({"path": PathKind.FUNCTION}, "MODULE:NAME"),
    ],
)
def test_a_path_without_what_it_needs_is_refused(spec, text):
    with pytest.raises(ConfigError, match=text):
        TargetSpec(**spec)


@pytest.mark.parametrize("path", DEMANDS)
@pytest.mark.parametrize("seed", range(5))
def test_limits_are_never_passed(path, seed):
    spec = TargetSpec(
        path=path, speed_m_s=0.5, turn_rate_rad_s=2.6, random_heading=True, acceleration_max_m_s2=0.5,
        speed_max_m_s=0.5, stop_period_s=1.5,
    )  # fmt: skip
    model = TargetModel(spec, seed)
    before = model.row()[0, FORWARD_AND_TURN]
    for _ in range(1500):
        model.run(1, DT, True)
        now = model.row()[0, FORWARD_AND_TURN]
        assert abs(now[0]) <= 0.5 + 1e-12
        assert abs(now[1]) <= spec.turn_rate_max_rad_s + 1e-12
        assert abs(now[0] - before[0]) <= 0.5 * DT + 1e-12
        assert abs(now[1] - before[1]) <= 0.5 / 0.08 * DT + 1e-12
        before = now


def test_pose_follows_from_the_twist_given_before():
    """The pad's next position follows from its pose, velocity and turn rate at the start of the interval."""
    spec = TargetSpec(
        path=PathKind.REVERSING, speed_m_s=0.5, turn_rate_rad_s=0.4, speed_max_m_s=0.5,
        pad_behind_axle_m=0.032, heave_amplitude_m=0.15, heave_rate_hz=0.25,
    )  # fmt: skip
    _, states = drive(spec)
    for before, after in itertools.pairwise(states):
        v, w = before.velocity_enu_m_s, before.yaw_rate_rad_s
        c, s = math.cos(w * DT), math.sin(w * DT)
        sx, sy = (s / w, (1.0 - c) / w) if w else (DT, 0.0)
        x, y, z = before.position_enu_m
        expected = (x + sx * v[0] - sy * v[1], y + sx * v[1] + sy * v[0], z + DT * v[2])
        assert after.position_enu_m == pytest.approx(expected, abs=1e-12)


Q_NORTH = quaternion_from_yaw(math.pi / 2)


def message(x_m, *, frame="map", q=Q_NORTH):
    return Odometry(5, frame, "target", (x_m, 2.0, 0.2), q, (0.5, 0.1, 0.0), (0.0, 0.0, 0.3)).pack()


def test_decodes_into_the_world_frame_also_when_the_frame_names_change():
    for frame in ("map", "map", "a_longer_name", "map"):
        deck = deck_state(message(1.0, frame=frame))
        assert deck.position_enu_m == (1.0, 2.0, 0.2)
        assert deck.velocity_enu_m_s == pytest.approx((-0.1, 0.5, 0.0))
        assert deck.yaw_rad == pytest.approx(math.pi / 2)
        assert deck.yaw_rate_rad_s == 0.3


def test_a_small_error_is_pulled_out_without_a_jump_and_a_large_one_is_not():
    robot = Deck((0.0, 0.0, 0.2), 0.0, (0.2, 0.0, 0.0), 0.0)
    x, yaw, dt = -0.02, 0.05, 0.01
    for k in range(100):
        deck = follow(robot._replace(position_enu_m=(0.2 * k * dt, 0.0, 0.2)), (x, 0.0, 0.2), yaw)
        assert deck.position_enu_m == (x, 0.0, 0.2)
        assert abs(deck.velocity_enu_m_s[0] - 0.2) <= 0.1 + 1e-9
        x += deck.velocity_enu_m_s[0] * dt
        yaw += deck.yaw_rate_rad_s * dt
    assert x == pytest.approx(0.2, abs=1e-3)
    assert yaw == pytest.approx(0.0, abs=1e-3)
    far = follow(robot, (5.0, 0.0, 0.2), 0.0)
    assert far.position_enu_m == robot.position_enu_m
