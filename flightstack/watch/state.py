"""Newest data of a flight on another machine, and their age on the watcher's clock.

A sample counts as new only if its tick differs from the last one: a sender that only repeats a tick counts as
silent.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum, IntEnum
from typing import Any

from bridge.zenoh import zenoh_link
from flightstack.core.types import FilterStatus, Landed, Mode, Phase
from logs.schema.rows import ControllerStepRow, HealthRow, LoopTimingRow

STALE_S = 1.0  # age above which data is stale, s; the slowest key is published every 0.2 s
_TIMINGS = 20  # number of timings in a second, for the mean period
_NOT_HEALTH = ("stamp_ns", "tick", "finished")  # fields that the step already contains
_RING = 8  # number of samples stored between two polls


class News(Enum):
    """State of the data: never received, fresh or stale."""

    NEVER = "no data yet"
    FRESH = "fresh"
    STALE = "stale"


class Watch:
    """Subscriber to the live keys of one onboard process; the caller polls it, and flights ignore it."""

    def __init__(
        self,
        session: zenoh_link.Session,
        namespace: str,
        *,
        clock: Callable[[], float] = time.monotonic,
        role: zenoh_link.Role = zenoh_link.Role.PEER,
    ) -> None:
        """Subscribe to the live keys.

        ``session``: the caller closes it; ``namespace``: first part of the keys; ``clock``: monotonic time,
        s; ``role``: role of the session. Raises ValueError: the namespace is not valid in a key.
        """
        self._session, self._clock, self._role = session, clock, role
        self._subscribers = {
            name: zenoh_link.ring_subscriber(session, f"{namespace}/{name}", _RING)
            for name in ("controller/step", "loop/timing", "health")
        }
        self.step: ControllerStepRow | None = None  # newest controller step; ``None`` before the first
        self.health: HealthRow | None = None  # newest health
        self.timings: deque[LoopTimingRow] = deque(maxlen=_TIMINGS)  # loop timing of the last second
        self.new_steps: list[ControllerStepRow] = []  # steps of the last poll
        self.new_timings: list[LoopTimingRow] = []  # loop timing of the last poll
        self.refused = 0  # number of samples of a wrong type for their key
        self._began_s = clock()
        self._step_s = self._health_s = math.nan

    def poll(self) -> None:
        """Read the samples that have arrived."""
        self.new_steps, self.new_timings = [], []
        for payload in self._payloads("controller/step"):
            step = self._decode(ControllerStepRow.unpack, payload)
            if step is not None and (self.step is None or step.tick != self.step.tick):
                self.step, self._step_s = step, self._clock()
                self.new_steps.append(step)
        for payload in self._payloads("loop/timing"):
            timing = self._decode(LoopTimingRow.unpack, payload)
            if timing is not None:
                self.timings.append(timing)
                self.new_timings.append(timing)
        for payload in self._payloads("health"):
            health = self._decode(HealthRow.unpack, payload)
            if health is not None and (self.health is None or health.tick != self.health.tick):
                self.health, self._health_s = health, self._clock()

    @property
    def age_s(self) -> float:
        """Time since the last new step, or since the subscription, s."""
        return self._clock() - (self._began_s if math.isnan(self._step_s) else self._step_s)

    @property
    def news(self) -> News:
        """State of the newest step: fresh, stale or never received."""
        if self.step is None:
            return News.NEVER
        return News.FRESH if self.age_s <= STALE_S else News.STALE

    @property
    def health_fresh(self) -> bool:
        """Whether the newest health is fresh."""
        return self._clock() - self._health_s <= STALE_S  # False if the time is NaN

    @property
    def connections(self) -> int:
        """Number of open Zenoh connections; 0: the other end is unreachable or rejects the connection."""
        return zenoh_link.transports(self._session)

    @property
    def past_router(self) -> bool:
        """Whether this session is a router's peer: the router does not forward data of its other peers."""
        return self._role is zenoh_link.Role.PEER and zenoh_link.knows_router(self._session)

    @property
    def over(self) -> bool:
        """Whether the onboard process reported that the flight is over."""
        return self.step is not None and self.step.finished

    def _payloads(self, name: str) -> list[bytes]:
        return [sample.payload.to_bytes() for sample in zenoh_link.drain(self._subscribers[name])]

    def _decode(self, unpack: Callable[[bytes], Any], payload: bytes) -> Any:
        try:
            return unpack(payload)
        except ValueError:  # another version, or a foreign publisher on this key: it is counted and shown
            self.refused += 1
            return None


def snapshot(watch: Watch) -> dict[str, Any]:
    """Return the newest values for scripts: ``None`` if unknown; ``fresh``: whether they are recent."""
    step, health = watch.step, watch.health
    values: dict[str, Any] = {
        "fresh": watch.news is News.FRESH,
        "news": watch.news.value,
        "age_s": round(watch.age_s, 3),
        "connections": watch.connections,
        "refused": watch.refused,
    }
    if step is not None:
        e_m = [p - q for p, q in zip(step.own_position_enu_m, step.target_position_enu_m, strict=True)]
        values |= {
            "tick": step.tick,
            "stamp_ns": step.stamp_ns,
            "phase": name_of(Phase, step.phase),
            "h_m": _number(step.h_m),
            "e_m": _vector(e_m),
            "nominal_enu_m_s": _vector(step.nominal_enu_m_s),
            "filtered_enu_m_s": _vector(step.filtered_enu_m_s),
            "setpoint_enu_m_s": _vector(step.command_enu_m_s) if step.setpoint_sent else None,
            "barrier_active": step.barrier_active,
            "filter_status": name_of(FilterStatus, step.filter_status),
            "finished": step.finished,
        }
    if health is not None:
        values["health"] = {"fresh": watch.health_fresh, **_plain(health)}
    return values


def name_of(kind: type[IntEnum], number: int) -> str:
    """Return the name of an enumeration's value; an unknown number is returned as text."""
    return kind(number).name if number in kind._value2member_map_ else str(number)


def _plain(health: HealthRow) -> dict[str, Any]:
    values = {name: value for name, value in health._asdict().items() if name not in _NOT_HEALTH}
    plain = {name: _number(value) if isinstance(value, float) else value for name, value in values.items()}
    return plain | {"mode": name_of(Mode, health.mode), "landed": name_of(Landed, health.landed)}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _vector(values: Sequence[float]) -> list[float] | None:
    return list(values) if all(map(math.isfinite, values)) else None
