"""``python -m sim.runners.warm_up``: compile the simulator's loops, so that no run waits for it."""

from __future__ import annotations

from sim.runners.companion import warm_up
from sim.scenarios.scenario import load

if __name__ == "__main__":
    warm_up(load("lab"))
