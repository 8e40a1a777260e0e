"""Tests the Gymnasium environment: flights equal to ``land``, spaces, rewards and errors."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flightstack as fs
from flightstack.common.strict_toml import ConfigError

NAME = "flightstack.api.env:flightstack/Landing-v0"


def flown(env, seed, action=None):
    """Fly one seed with an agent; return the rewards of all steps and the last info dictionary."""
    env.reset(seed=seed)
    rewards, over = [], False
    while not over:
        chosen = env.builtin_action() if action is None else action
        _, reward, terminated, truncated, info = env.step(chosen)
        rewards.append(reward)
        over = terminated or truncated
    return rewards, info


@pytest.mark.parametrize("name", ["paper", "robust"])
def test_the_built_in_policy_flies_as_land_does_bit_by_bit(name):
    env = fs.make_env("lab", filter=name)
    _, info = flown(env, 7)
    landing = fs.land("lab", 7, filter=name)
    assert info["verdict"] == landing.verdict
    truth = env.truth
    for field, values in vars(landing.truth).items():
        if isinstance(values, np.ndarray):
            assert np.array_equal(getattr(truth, field), values, equal_nan=values.dtype.kind == "f"), field


@pytest.mark.parametrize("name", [None, "paper", "robust"])
def test_an_agent_sees_and_flies_the_same_without_compiled_ticks(name, monkeypatch):
    """States and rewards are equal with and without compiled ticks, also if Python repeats a tick."""

    def seen():
        env, rng = fs.make_env("storm", filter=name), np.random.default_rng(4)
        rows, over = [env.reset(seed=5)[0]], False
        while not over and len(rows) < 900:
            wild = rng.uniform(-0.4, 0.4, 3) if len(rows) % 3 else 0.0
            row, reward, over, _, _ = env.step(env.builtin_action() + wild)
            rows.append((*row, reward))
        env.close()
        return rows

    compiled = seen()
    monkeypatch.setattr("sim.runners.landing.suited", lambda *_: False)
    plain = seen()
    assert len(compiled) == len(plain)
    assert all(np.array_equal(a, b) for a, b in zip(compiled, plain, strict=True))


@pytest.mark.filterwarnings("ignore")  # Gymnasium's checker warns about missing render modes and float64
def test_gymnasium_finds_it_and_its_checker_passes():
    env = gymnasium.make(NAME, scenario="lab", filter="paper")
    check_env(env.unwrapped)
    assert env.observation_space.shape == (13,)
    assert env.action_space.high.tolist() == list(fs.scenario("lab").onboard.limits.velocity_max_m_s)


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_the_robust_filter_keeps_an_agent_safe_that_flies_at_the_pad_at_full_speed(seed: int):
    env = fs.make_env("lab", filter="robust")
    seen, _ = env.reset(seed=seed)
    over = False
    while not over:
        seen, _, terminated, truncated, info = env.step(-np.sign(seen[:3]) * env.action_space.high)
        over = terminated or truncated
    assert info["outcome"] == "landed"
    assert info["violation"] is False


def test_an_agent_without_a_filter_violates_and_with_one_does_not():
    down = np.array([0.0, 0.0, -0.5])
    rewards, bare = flown(fs.make_env("lab"), 1, down)
    _, safe = flown(fs.make_env("lab", filter="robust"), 1, down)
    assert bare["violation"]
    assert min(rewards[:-1]) < -0.09  # a tick below the barrier has a negative reward
    assert rewards[-1] <= -10.0  # -10 is the reward of a crash
    assert safe["violation"] is False


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectors_of_environments_fly_their_seeds(mode):
    envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode=mode, scenario="lab", filter="paper")
    seen, _ = envs.reset(seed=[7, 8])
    alone, _ = fs.make_env("lab", filter="paper").reset(seed=8)
    assert np.array_equal(seen[1], alone)
    seen, rewards, *_ = envs.step(np.zeros((2, 3)))
    assert seen.shape == (2, 13)
    assert np.isfinite(rewards).all()
    envs.close()


def test_bad_input_is_named():
    with pytest.raises(ConfigError, match="filter: found 'best', allowed"):
        fs.make_env("lab", filter="best")
    env = fs.make_env("lab")
    env.reset(seed=1)
    with pytest.raises(ValueError, match="three finite numbers"):
        env.step(np.array([np.nan, 0.0, 0.0]))
    env.close()
