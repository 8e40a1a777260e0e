"""Train a landing by PPO (stable-baselines3), then compare it with and without the safety filter.

    pip install "crazyflie-flightstack[sim,env,rl]"
    python examples/train_ppo.py [STEPS [SEEDS]]

200,000 steps take some minutes. The agent trains without a filter. The table shows the outcomes of its
landings without a filter, with the paper's filter, and with the robust filter.
"""

import sys
from collections import Counter

from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO

import flightstack as fs

steps = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 1000


def made(name: str | None) -> RescaleAction:
    """Return an environment with actions from -1 to 1."""
    return RescaleAction(fs.make_env("lab", filter=name), -1.0, 1.0)


agent = PPO("MlpPolicy", made(None), n_steps=2048, gamma=0.995, seed=0, device="cpu", verbose=1)
agent.learn(steps)
for name in (None, "paper", "robust"):
    env, found = made(name), Counter()
    for seed in range(seeds):
        seen, info = env.reset(seed=seed)
        over = False
        while not over:
            action, _ = agent.predict(seen, deterministic=True)
            seen, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        found.update([info["outcome"], *(["violations"] if info["violation"] else [])])
    print(f"filter {name}: {dict(found)}")
