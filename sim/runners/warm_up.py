"""``python -m sim.runners.warm_up``: compile the simulator's loops, so that no run waits for it."""

from __future__ import annotations

from sim.scenarios.scenario import load
from sim.vehicle.vehicle import warm_up

if __name__ == "__main__":
    warm_up(load("lab"))
