"""``python -m sim.warm_up``: compile the simulator's loops into their cache, so that no run waits for it."""

from __future__ import annotations

from sim.scenario import load
from sim.vehicle import warm_up

if __name__ == "__main__":
    warm_up(load("lab"))
