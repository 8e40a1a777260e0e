"""Train a landing by PPO (stable-baselines3), then compare it with and without the safety filter.

    pip install -e '.[sim,env,rl]'
    python examples/train_ppo.py [DECISIONS [SEEDS]]

The agent trains without a filter; 200,000 decisions take some minutes. The table shows the outcomes of its
landings without a filter, with the paper's filter, and with the robust filter.
"""

import sys
from collections import Counter
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecNormalize

import flightstack as fs

TICKS = 10  # number of ticks (0.01 s each) for which a decision is applied
TRAINING = {"duration_max_s": 25.0}  # maximum duration of an episode; a landing takes 5 to 10 s
GAMMA = 0.95  # discount factor per decision (0.1 s): a horizon of 2 s; the vehicle responds within 0.5 s


class Decisions(gymnasium.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """Repeat each action for ``TICKS`` ticks."""

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Return the last observation, the sum of the rewards, and flags and info of the last tick."""
        total, over = 0.0, False
        for _ in range(TICKS):
            if not over:
                seen, reward, terminated, truncated, info = self.env.step(action)
                total, over = total + float(reward), terminated or truncated
        return seen, total, terminated, truncated, info


def made(filter: str | None = None, changes: dict[str, float] | None = None) -> RescaleAction:
    """Return an environment whose actions are scaled to the range from -1 to 1."""
    return RescaleAction(Decisions(fs.make_env("lab", filter, changes)), -1.0, 1.0)


decisions = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
training = VecNormalize(make_vec_env(lambda: made(changes=TRAINING), n_envs=16, seed=0), gamma=GAMMA)
ppo = {"n_steps": 64, "batch_size": 256, "gamma": GAMMA, "learning_rate": 1e-3}
agent = PPO("MlpPolicy", training, **ppo, seed=0, device="cpu", verbose=1)
agent.learn(decisions)
training.training = False  # the evaluation does not change the mean and variance of the observations
for name in (None, "paper", "robust"):
    env, found = made(name), Counter[str]()
    for seed in range(seeds):
        seen, info = env.reset(seed=seed)
        over = False
        while not over:
            action, _ = agent.predict(training.normalize_obs(seen), deterministic=True)
            seen, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        found.update([info["outcome"], *(["violations"] if info["violation"] else [])])
    print(f"filter {name}: {dict(found)}", flush=True)
