"""The paper's filter, eq. 11 as printed.

It takes the newest sample of the target, holds the barrier itself and sends the filtered velocity.
"""

from __future__ import annotations

from typing import Annotated

from flightstack.core.memory import MotionMemory
from flightstack.core.numeric import UNSEEN
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.safety.barrier import Barrier
from flightstack.core.safety.position_loop import nominal_velocity
from flightstack.core.snapshot import Relative
from flightstack.core.strategies.strategy import Strategy
from flightstack.core.types import Vec3


class PaperFilter(Strategy):
    """Eq. 11 as printed: the velocity loop is taken to be perfect, and nothing is estimated."""

    certificate = "flightstack.verify.certificate:paper_checks"
    watches_swinging = False  # as printed: it knows nothing of the velocity loop
    waits_filtered = False
    motion: Annotated[MotionMemory, UNSEEN]  # it estimates nothing
    _config: FlightConfig
    _barrier: Barrier

    def __init__(self, config: FlightConfig, barrier: Barrier) -> None:
        super().__init__(config, barrier)
        self._config, self._barrier = config, barrier

    def barrier(self, at: Relative) -> Barrier:
        """The paper's barrier."""
        return self._barrier

    def approach_m_s(self, at: Relative, over_pad: bool) -> Vec3:
        """Position loop with the target's velocity fed forward (paper IV-A)."""
        return nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, at.target.velocity_enu_m_s)

    def descent_m_s(self, at: Relative) -> Vec3:
        """Straight down over the pad's middle."""
        t = at.target.velocity_enu_m_s
        x, y, _ = nominal_velocity(at.e_m, self._config.position_loop.gain_1_s, t)
        return (x, y, t[2] - self._config.touchdown.descent_m_s)

    def may_touch(self, at: Relative) -> bool:
        """Below the touchdown height in the descending cone (paper V)."""
        touchdown = self._config.touchdown
        low = at.e_m[2] < touchdown.height_m and at.d_m <= touchdown.pad_radius_m
        return low and self._barrier.h(at.e_m) >= 0.0
