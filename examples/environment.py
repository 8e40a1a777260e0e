"""Fly two landings side by side with ``gymnasium.make_vec`` and the stack's own velocity commands.

python examples/environment.py
"""

import gymnasium
import numpy as np

# gymnasium imports flightstack.api.env, which registers the name
name = "flightstack.api.env:flightstack/Landing-v0"
env = gymnasium.make_vec(name, num_envs=2, scenario="lab", filter="robust")
seen, infos = env.reset(seed=[7, 8])
print(f"observations {env.observation_space.shape}, actions {env.action_space.shape}")
ended = np.zeros(2, bool)
while not ended.all():
    # velocity commands of the stack; a trained agent would compute the actions from ``seen``
    actions = np.array(env.call("builtin_action"))
    seen, rewards, terminated, truncated, infos = env.step(actions)
    for n in np.flatnonzero((terminated | truncated) & ~ended):
        print(f"environment {n}: {infos['outcome'][n]}, last reward {rewards[n]:+.1f}")
    ended |= terminated | truncated
env.close()
