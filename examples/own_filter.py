"""Your own safety filter with one method: it smooths the velocity and enforces the barrier.

    flightstack sitl --scenario lab --lockstep --filter examples.own_filter:Smooth
    flightstack campaign lab --runs 20 --filter examples.own_filter:Smooth

``filter = "examples.own_filter:Smooth"`` in a configuration selects it. Python looks for the module among the
installed modules first, then in the working folder.
"""

from dataclasses import dataclass

import numpy as np

import flightstack as fs


class Smooth(fs.Filter):
    """Low-pass the nominal velocity; return the nearest velocity that satisfies all constraints."""

    @dataclass
    class State:
        """State between ticks; logs contain it, and a replay compares it."""

        velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def filter(self, nominal: np.ndarray, at: fs.At) -> np.ndarray:
        """Return the velocity to be flown, m/s ENU; ``at`` contains vehicle, target, barrier and limits."""
        before = np.array(self.state.velocity_m_s)
        smooth = before + 0.2 * (nominal - before)
        self.state.velocity_m_s = tuple(smooth.tolist())
        return at.enforced(smooth)


if __name__ == "__main__":
    verdict = fs.land("lab", seed=7, filter=Smooth).verdict
    print(f"{verdict.outcome}: {verdict.reason}")
