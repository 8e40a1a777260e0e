"""A user's filter: its input ``At``, the check of its result, and what it exchanges with compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import takewhile
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flightstack.common.text import one_line
from flightstack.core.safety.projection import projected
from flightstack.core.snapshot import Relative
from flightstack.core.target.track import TargetState
from flightstack.core.types import ZERO, OwnState, Vec3

Vector = NDArray[np.float64]
NEEDED = "three finite numbers (m/s ENU) are needed"


class At(NamedTuple):
    """Data of a tick for ``Filter.filter``; vectors are arrays (3,) in ENU.

    Attributes:
        t_s: time of the vehicle state on the stack's clock, s.
        position_enu_m: current position of the vehicle, as the filter estimates it, m.
        velocity_enu_m_s: velocity of the vehicle, m/s.
        target_position_enu_m: position of the landing spot, m.
        target_velocity_enu_m_s: velocity of the landing spot, m/s.
        e_m: position of the vehicle minus landing spot, m.
        d_m: horizontal length of ``e_m``, m.
        h_m: value of the barrier, m; a negative value is unsafe.
        gradient: gradient of the barrier with respect to the vehicle's position.
        dh_dt_m_s: partial time derivative of the barrier due to the target's motion, m/s.
        rate_1_s: maximum allowed decay rate of h, 1/s.
        lower_m_s: minimum allowed velocity command in this tick, by velocity and slew limits, m/s.
        upper_m_s: maximum allowed velocity command in this tick, by the same limits, m/s.
        permitted: function that limits a velocity to the assumptions of the barrier's margin; it raises
        ValueError as ``enforced`` does.
    """

    t_s: float
    position_enu_m: Vector
    velocity_enu_m_s: Vector
    target_position_enu_m: Vector
    target_velocity_enu_m_s: Vector
    e_m: Vector
    d_m: float
    h_m: float
    gradient: Vector
    dh_dt_m_s: float
    rate_1_s: float
    lower_m_s: Vector
    upper_m_s: Vector
    permitted: Callable[[ArrayLike], Vec3]

    @property
    def bound_m_s(self) -> float:
        """Bound of eq. 11, m/s: a velocity keeps the barrier if gradient . velocity >= this bound."""
        return -self.rate_1_s * self.h_m - self.dh_dt_m_s

    def enforced(self, velocity_m_s: ArrayLike) -> Vector:
        """Return the nearest permitted velocity that keeps the barrier, or the one that raises h most.

        Args:
            velocity_m_s: (3,) ENU.

        Raises:
            ValueError: the velocity is not three finite numbers.
        """
        permitted = self.permitted(checked_velocity(velocity_m_s, "at.enforced"))
        gradient, lower, upper = self.gradient.tolist(), self.lower_m_s.tolist(), self.upper_m_s.tolist()
        found, _ = projected(permitted, tuple(gradient), self.bound_m_s, tuple(lower), tuple(upper))
        return np.array(found)


def three_finite(found: Any) -> Vector | None:
    """Return the result of a filter as an array; None if it is not three finite numbers."""
    try:
        numbers = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return numbers if numbers.shape == (3,) and np.isfinite(numbers).all() else None


def checked_velocity(found: Any, where: str) -> Vec3:
    """Return a velocity that a user's filter gave to the function ``where``.

    Raises ValueError: it is not three finite numbers.
    """
    numbers = three_finite(found)
    if numbers is None:
        raise ValueError(f"{where}: found {one_line(repr(found)):.60}; {NEEDED}")
    x, y, z = numbers.tolist()
    return (x, y, z)


Ask = Callable[[Relative, Vec3], Vec3]  # agent: vehicle relative to target, nominal velocity -> velocity


NOWHERE = Relative(OwnState(0.0, 0.0, ZERO, ZERO, 0.0), TargetState(0.0, ZERO, ZERO, 0.0), ZERO, 0.0)


@dataclass(slots=True)
class Exchange:
    """Arguments of a call from compiled code to an agent or a user's filter, and the answer."""

    agent: bool = False  # whether a learning agent chooses the nominal velocity
    function: int = 0  # address of the C function that calls the agent or the filter
    at: Relative = NOWHERE
    nominal: Vec3 = ZERO  # nominal velocity of the stack, m/s ENU
    h_m: float = math.nan  # value of the active barrier, m
    gradient: Vec3 = ZERO  # gradient of the active barrier with respect to position
    dh_dt_m_s: float = math.nan  # partial time derivative of the active barrier, m/s
    lower_m_s: Vec3 = ZERO  # minimum velocity within velocity and slew limits, m/s
    upper_m_s: Vec3 = ZERO  # maximum velocity within velocity and slew limits, m/s
    chosen: Vec3 = ZERO  # answer: velocity that the agent or the user's filter chooses, m/s ENU


_PLAIN = {"filter", "State", "certificate", "__init__", "__doc__", "__module__", "__annotations__"}
_STATE = frozenset(
    ("motion", "tracking", "own", "late", "memory", "exchange", "estimator", "own_estimator", "_tracking")
)


def compiled_as(cls: type) -> type | None:
    """Return the packaged class whose flights differ from this class only in ``filter``.

    Return None if the class overrides more, or can change estimators, which compiled code has copied.
    """
    own = [*takewhile(lambda each: not each.__module__.startswith("flightstack."), cls.__mro__)]
    base = cls.__mro__[len(own)]
    for name, value in ((name, value) for each in own for name, value in vars(each).items()):
        if hasattr(base, name) and name not in _PLAIN and not name.startswith("__static"):
            return None
        function = getattr(value, "__func__", value)
        if isinstance(function, FunctionType) and name != "__init__":
            if _names(function.__code__) & (_STATE | {"getattr", "vars", "__dict__"}):
                return None
        elif name == "filter":
            return None
    return base if hasattr(base, "certificate") else None


def _names(code: CodeType) -> set[str]:
    """Return the names of attributes and globals that a function and its inner functions use."""
    inner = (_names(each) for each in code.co_consts if isinstance(each, CodeType))
    return set(code.co_names).union(*inner)
