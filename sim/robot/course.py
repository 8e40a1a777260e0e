"""Robot paths that depend on its pose: waypoints, and a function written by the user."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from flightstack.common.strict_toml import ConfigError
from flightstack.common.text import ROBOT_FAILED, one_line
from flightstack.core.parameters.filters import file_of, referred
from sim.scenarios.tables import PathKind, TargetSpec

# function from driven time (s), axle position (m, ENU) and heading (rad) to speed (m/s) and turn rate (rad/s)
Course = Callable[[float, float, float, float], tuple[float, float]]
GAIN_1_S = 2.0  # turn rate divided by the heading error to the waypoint, 1/s (assumption)
REACHED_M = 0.05  # distance at which a waypoint counts as reached, m


class Waypoints:
    """Steers to each waypoint in order, repeatedly; turns on the spot if the next one is behind the robot."""

    def __init__(
        self, points_m: Sequence[tuple[float, float]], speed_m_s: float, turn_rate_rad_s: float
    ) -> None:
        self._points, self._speed, self._turn = points_m, speed_m_s, turn_rate_rad_s
        self._next = 0

    def __call__(self, t_s: float, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        del t_s
        to_x, to_y = self._points[self._next]
        if math.hypot(to_x - x_m, to_y - y_m) < REACHED_M:
            self._next = (self._next + 1) % len(self._points)
            to_x, to_y = self._points[self._next]
        off_rad = math.remainder(math.atan2(to_y - y_m, to_x - x_m) - yaw_rad, math.tau)
        turn = max(-self._turn, min(self._turn, GAIN_1_S * off_rad))
        return self._speed * max(0.0, math.cos(off_rad)) ** 3, turn


class Function:
    """Steers by the user's function, limited to the scenario's speed and turn rate."""

    def __init__(self, name: str, speed_m_s: float, turn_rate_rad_s: float) -> None:
        self._name, self._speed, self._turn = name, speed_m_s, turn_rate_rad_s
        self._function: Any = referred(name, "target.function")

    def __call__(self, t_s: float, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
        try:
            found = self._function(t_s, x_m, y_m, yaw_rad)
        except Exception as error:
            raise self._error(f"raised {type(error).__name__}: {error}", t_s) from error
        try:
            speed, turn = map(float, found)
        except (TypeError, ValueError):
            speed = turn = math.nan
        if not (math.isfinite(speed) and math.isfinite(turn)):
            raise self._error(f"returned {one_line(repr(found)):.60}", t_s)
        return max(-self._speed, min(self._speed, speed)), max(-self._turn, min(self._turn, turn))

    def _error(self, problem: str, t_s: float) -> ConfigError:
        return ConfigError(f"{ROBOT_FAILED} {file_of(self._name)} {problem} at t = {t_s:.2f} s; {_NEEDED}")


_NEEDED = "called with t_s, x_m, y_m, yaw_rad it must return speed and turn rate, in m/s and rad/s"


def course(spec: TargetSpec, speed_m_s: float, turn_rate_rad_s: float) -> Course | None:
    """Return the steering that depends on the robot's pose; None for a path that depends only on time.

    ``speed_m_s``, ``turn_rate_rad_s``: limits, drawn from the seed.
    Raises ConfigError: the function cannot be imported.
    """
    if spec.path is PathKind.WAYPOINTS:
        return Waypoints(spec.waypoints_m, speed_m_s, abs(turn_rate_rad_s))
    if spec.path is PathKind.FUNCTION:
        return Function(spec.function, speed_m_s, abs(turn_rate_rad_s))
    return None


def try_out(spec: TargetSpec) -> None:
    """Call the function of a path once, at its start. Raises ConfigError: the function cannot be used."""
    if (steers := course(spec, spec.speed_m_s, spec.turn_rate_rad_s)) is not None:
        steers(0.0, *spec.position_m, spec.heading_rad)
