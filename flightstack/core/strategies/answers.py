"""Passes the answer of an agent, or of a user's method ``filter``, to a compiled tick.

Compiled code cannot call Python. It computes the arguments, Python calls agent or filter, and the tick
continues with the answer, which is stored in ``Filter.exchange``.
"""

from __future__ import annotations

from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

from flightstack.core.safety.qp_filter import FilterResult
from flightstack.core.snapshot import Relative
from flightstack.core.types import FilterStatus, Vec3

Ask = Callable[[Relative, Vec3], Vec3]  # agent: vehicle relative to target, nominal velocity -> velocity


def chosen(one: Any, _at: Relative, own: Vec3) -> Vec3:
    """Compiled form of ``Filter.choose``: the agent's answer is given before the tick."""
    exchange = one.exchange
    if not exchange.agent:
        return own
    exchange.nominal = own
    answer: Vec3 = exchange.chosen
    return answer


def filtered(
    one: Any, _at: Relative, h_m: float, gradient: Vec3, dh_dt_m_s: float, nominal: Vec3, lower: Vec3,
    upper: Vec3,
) -> FilterResult:  # fmt: skip
    """Compiled form of ``Filter.filtered``: the result of the user's filter is given before the tick."""
    exchange = one.exchange
    exchange.nominal, exchange.h_m, exchange.gradient, exchange.dh_dt_m_s = nominal, h_m, gradient, dh_dt_m_s
    exchange.lower_m_s, exchange.upper_m_s = lower, upper
    return FilterResult(exchange.chosen, 0.0, False, FilterStatus.OWN, 0.0, 0, 0.0)


_PLAIN = {"filter", "State", "certificate", "__init__", "__doc__", "__module__", "__annotations__"}
_STATE = frozenset(
    ("motion", "tracking", "own", "late", "memory", "exchange", "estimator", "own_estimator", "_tracking")
)


def compiled_as(cls: type) -> type | None:
    """Return the packaged class whose flights differ from this class only in ``filter``.

    Return None if the class overrides more, or may read estimators, whose state exists only in compiled code.
    """
    own: list[type] = []
    for base in cls.__mro__:
        if base.__module__.partition(".")[0] == "flightstack":
            break
        own.append(base)
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
