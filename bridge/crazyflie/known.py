"""What the bridge knows of its Crazyflie, and whether that is fresh and good enough."""

from __future__ import annotations

from bridge.crazyflie.checks import STATE_AGE_MAX_S, Seen, position_known, problems
from bridge.crazyflie.rules import LOST_S
from bridge.crazyflie.types import CrazyflieState, Health, Link


class Known:
    """The newest of everything.

    Attributes:
        link: the firmware on the other side.
        state: newest state; its age is for the reader to judge.
        health: newest word on estimate and battery.
        mocap_problem: why there are no good poses from outside, None: there are, or none are needed.
    """

    def __init__(self, *, mocap: bool) -> None:
        self.link = Link()
        self.state: CrazyflieState | None = None
        self.health: Health | None = None
        self.mocap_problem: str | None = "mocap: no pose yet" if mocap else None

    def alive(self, now_s: float) -> bool:
        """Whether it is heard; without that nothing is said in its name."""
        heard = self.state is not None and now_s - self.state.at_s <= LOST_S
        return heard and self.link.protocol is not None

    def problems(self, now_s: float) -> list[str]:
        """Reasons against arming, now."""
        return problems(self._seen(now_s))

    def position_known(self, now_s: float) -> bool:
        """Whether its estimate of position may be flown by."""
        return position_known(self._seen(now_s))

    def fresh_state(self, now_s: float) -> CrazyflieState | None:
        """The newest state, None when it is too old to fly by."""
        state = self.state
        return state if state is not None and now_s - state.at_s <= STATE_AGE_MAX_S else None

    def _seen(self, now_s: float) -> Seen:
        return Seen(now_s, self.link, self.state, self.health, self.mocap_problem)
