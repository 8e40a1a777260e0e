"""A safety filter of your own: one method. This one lets the velocity change slowly, and keeps the barrier.

    flightstack sitl --scenario lab --lockstep --filter examples.own_filter:Smooth
    flightstack campaign lab --runs 20 --filter examples.own_filter:Smooth

A configuration names it by ``filter = "examples.own_filter:Smooth"``. The module is looked for among the
installed ones, then in the working folder.
"""

from dataclasses import dataclass

import numpy as np

import flightstack as fs


class Smooth(fs.Filter):
    """First-order low-pass of the nominal velocity, then the nearest velocity that keeps the barrier."""

    @dataclass
    class State:
        """What it stores from tick to tick: logs hold it, and a replay restores it."""

        velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def filter(self, nominal: np.ndarray, at: fs.At) -> np.ndarray:
        """Return the velocity to fly, m/s ENU; ``at`` has vehicle, target, barrier and limits."""
        before = np.array(self.state.velocity_m_s)
        smooth = before + 0.2 * (nominal - before)
        self.state.velocity_m_s = tuple(smooth.tolist())
        return at.enforced(smooth)


if __name__ == "__main__":
    verdict = fs.land("lab", seed=7, filter=Smooth).verdict
    print(f"{verdict.outcome}: {verdict.reason}")
