"""Your own controller: it computes a velocity in each tick, and the safety filter enforces the barrier.

python examples/own_controller.py [SEEDS]
"""

import sys

import numpy as np

import flightstack as fs

GAIN_1_S = np.array([1.2, 1.2, 0.6])

env = fs.make_env("lab", filter="paper")
for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 5):
    seen, info = env.reset(seed=seed)
    over = False
    while not over:
        # position of the vehicle relative to the landing spot, m; velocity of the landing spot, m/s
        e_m, target_m_s = seen[0:3], seen[6:9]
        seen, reward, terminated, truncated, info = env.step(target_m_s - GAIN_1_S * e_m)
        over = terminated or truncated
    print(f"seed {seed}: {info['verdict'].reason}")
