"""The newest state of a flight as plain values, for scripts."""

from __future__ import annotations

import math
from typing import Any

from flightstack.core.types import FilterStatus, Landed, Mode, Phase
from flightstack.watch.state import News, Watch


def snapshot(watch: Watch) -> dict[str, Any]:
    """Newest values; what is not known, or not a number, is ``None``; ``fresh`` says whether to believe."""
    step, health = watch.step, watch.health
    values: dict[str, Any] = {
        "fresh": watch.news is News.FRESH,
        "news": watch.news.value,
        "age_s": round(watch.age_s, 3),
        "connections": watch.connections,
        "refused": watch.refused,
    }
    if step is not None:
        values |= {
            "tick": step.tick,
            "stamp_ns": step.stamp_ns,
            "phase": _name(Phase, step.phase),
            "h_m": _number(step.h_m),
            "e_m": _vector(_minus(step.own_position_enu_m, step.target_position_enu_m)),
            "nominal_enu_m_s": _vector(step.nominal_enu_m_s),
            "filtered_enu_m_s": _vector(step.filtered_enu_m_s),
            "setpoint_enu_m_s": _vector(step.command_enu_m_s) if step.setpoint_sent else None,
            "barrier_active": step.barrier_active,
            "filter_status": _name(FilterStatus, step.filter_status),
            "finished": step.finished,
        }
    if health is not None:
        values["health"] = {
            "fresh": watch.health_fresh,
            **{
                name: _number(getattr(health, name))
                for name in ("own_age_s", "target_age_s", "link_age_s", "battery_v", "battery_share")
            },
            "mode": _name(Mode, health.mode),
            "landed": _name(Landed, health.landed),
            **{
                name: getattr(health, name)
                for name in ("armed", "ready_to_arm", "own_valid", "target_valid", "link_valid",
                             "target_accepted", "target_rejected", "overruns", "feed_dropped", "reason")
            },
        }  # fmt: skip
    return values


def _name(kind: Any, number: int) -> str:
    return str(kind(number).name) if number in kind._value2member_map_ else str(number)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _vector(values: tuple[float, ...]) -> list[float] | None:
    return list(values) if all(map(math.isfinite, values)) else None


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(p - q for p, q in zip(a, b, strict=True))
