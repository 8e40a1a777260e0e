"""Newest state and condition of a Crazyflie, and whether they are fresh and good enough."""

from __future__ import annotations

import math

from bridge.crazyflie.checks import FIT, HEALTH_AGE_MAX_S, STATE_AGE_MAX_S, Seen, position_known, problems
from bridge.crazyflie.rules import LOST_S
from bridge.crazyflie.types import CrazyflieState, Health, Info, Link, Outside
from bridge.frames import Quat, body_from_world, yaw_from_quaternion
from bridge.mavlink.server.commander import Battery
from bridge.mavlink.server.profile import POSITION_SOURCE
from bridge.mocap.checks import Limits, Passed
from flightstack.core.types import ZERO, Vec3

_UP: Vec3 = (0.0, 0.0, 1.0)
_GAP_MAX_S = Limits().gap_max_s  # s without a pose until that is a problem
_SHARE = 0.1  # of a new difference in the mean one, at 10 Hz: a second
_AT_REST_G = 0.1  # g; an accelerometer that shows another length shows more than gravity


class Known:
    """Poses from outside come through this bridge or from another program.

    The firmware logs the time of the newest pose from any sender (``locSrvZ.tick``): once that has changed,
    poses are expected.
    """

    def __init__(self, *, mocap: bool) -> None:
        self.link = Link()
        self.state: CrazyflieState | None = None  # newest, of any age
        self.health: Health | None = None  # newest quality of the estimate, and battery
        # reason why there are no good poses from outside; None: there are, or none are needed
        self.mocap_problem: str | None = "mocap: no pose yet" if mocap else None
        self._mocap, self._posed_s = mocap, -math.inf
        self._pose_quaternion: Quat | None = None  # of the newest pose through this bridge
        self._fit_s = -math.inf
        self._forget_outside()

    def _forget_outside(self) -> None:
        """Another connection may be to another firmware."""
        self._outside: Outside | None = None
        self._tick_s: float | None = None  # when the firmware's time of the newest pose changed last
        self._leaning: Vec3 | None = None  # mean of the poses' upright less gravity's, in the body

    def alive(self, now_s: float) -> bool:
        """Whether it is heard; while it is not, no telemetry is sent."""
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

    def yaw_rad(self) -> float | None:
        """Heading, counter-clockwise from east; None: no state yet."""
        return yaw_from_quaternion(self.state.quaternion) if self.state is not None else None

    def sensors_healthy(self, now_s: float) -> int:
        """The position, while it may be flown by."""
        return POSITION_SOURCE if self.position_known(now_s) else 0

    @property
    def battery(self) -> Battery:
        """Battery, by the firmware."""
        voltage_v = self.state.battery_v if self.state is not None else 0.0
        return Battery(voltage_v, self.health.battery_percent if self.health is not None else -1)

    def take_health(self, health: Health) -> None:
        """Quality of the estimate, and battery."""
        self.health = health
        if self._outside is None:
            self._compare_level(None)

    def take_outside(self, outside: Outside) -> None:
        """Take the firmware's time of the newest pose from outside, and gravity."""
        before, self._outside = self._outside, outside
        if before is None:
            self._leaning = None  # gravity is measured from now on
        elif before.tick != outside.tick:
            self._tick_s = outside.at_s
        self._compare_level(outside.acceleration_flu_g)

    def _note_pose(self, problem: str | None, passed: Passed | None, now_s: float) -> None:
        if passed is not None:
            self._posed_s = max(self._posed_s, passed.measured_s)
            self._pose_quaternion = passed.pose.orientation_wxyz
        elif problem is None:
            self._posed_s = max(self._posed_s, now_s - _GAP_MAX_S)  # there would be one otherwise

    def _pose_age_s(self, now_s: float) -> float | None:
        """Age of the newest pose from outside that has arrived; None: none are expected."""
        ages_s = [now_s - self._posed_s] if self._mocap else []
        if self._outside is not None and self._tick_s is not None:
            heard = now_s - self._outside.at_s <= HEALTH_AGE_MAX_S
            ages_s.append(self._outside.at_s - self._tick_s if heard else math.inf)
        return max(ages_s, default=None)

    def _compare_level(self, acceleration_flu_g: Vec3 | None) -> None:
        """Compare the poses' upright with gravity's, on the ground.

        Without an accelerometer its own attitude stands for gravity, as long as that is not the poses'.
        """
        if self.state is None or self.state.info & Info.FLYING:
            return
        attitude = self._pose_quaternion
        if attitude is None and self._tick_s is not None:
            attitude = self.state.quaternion  # by poses of another program
        if attitude is None:
            return
        gravity = acceleration_flu_g or body_from_world(self.state.quaternion, _UP)
        length = math.hypot(*gravity)
        if abs(length - 1.0) > _AT_REST_G:
            return
        leaning = tuple(a - b / length for a, b in zip(body_from_world(attitude, _UP), gravity, strict=True))
        mean = self._leaning or leaning
        x, y, z = (m + _SHARE * (new - m) for m, new in zip(mean, leaning, strict=True))
        self._leaning = (x, y, z)

    def _seen(self, now_s: float) -> Seen:
        leaning = math.hypot(*(self._leaning or ZERO))
        return Seen(
            now_s,
            self.link,
            self.state,
            self.health,
            self.mocap_problem,
            self._pose_age_s(now_s),
            2.0 * math.asin(min(1.0, 0.5 * leaning)),
            self._fit_s,
        )

    def _note_fitness(self, state: CrazyflieState) -> None:
        if state.info & FIT:
            self._fit_s = state.at_s
