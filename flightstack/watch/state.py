"""What a watcher knows of a flight on another machine, and how old that is by the watcher's own clock.

A sample counts as news only if its tick is another one than before: a sender that repeats itself is as
silent as one that says nothing.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Any

from bridge.zenoh import zenoh_link
from logs.schema.rows import ControllerStepRow, HealthRow, LoopTimingRow

STALE_S = 1.0  # s; the slowest of the keys comes every 0.2 s
_TIMINGS = 20  # a second of them, for the mean period
_RING = 8  # samples kept between two looks


class News(Enum):
    """How good what we have is."""

    NEVER = "no data yet"
    FRESH = "fresh"
    STALE = "stale"


class Watch:
    """Subscribes to the live keys of one onboard process; polled, nothing depends on it.

    Attributes:
        step: newest controller step, ``None`` before the first.
        health: newest health.
        timings: the last second of loop timing.
        new_steps: what came with the last poll.
        new_timings: the same of loop timing.
        refused: samples that were not what their key promises.
    """

    def __init__(
        self,
        session: zenoh_link.Session,
        namespace: str,
        *,
        clock: Callable[[], float] = time.monotonic,
        role: zenoh_link.Role = zenoh_link.Role.PEER,
    ) -> None:
        """Subscribe.

        Args:
            session: an open Zenoh session; it stays the caller's.
            namespace: first part of the keys, for example ``cf1``.
            clock: seconds that never go back.
            role: what the session is.

        Raises:
            ValueError: the namespace makes no allowed key.
        """
        self._session, self._clock, self._role = session, clock, role
        self._subscribers = {
            name: zenoh_link.ring_subscriber(session, f"{namespace}/{name}", _RING)
            for name in ("controller/step", "loop/timing", "health")
        }
        self.step: ControllerStepRow | None = None
        self.health: HealthRow | None = None
        self.timings: deque[LoopTimingRow] = deque(maxlen=_TIMINGS)
        self.new_steps: list[ControllerStepRow] = []
        self.new_timings: list[LoopTimingRow] = []
        self.refused = 0
        self._began_s = clock()
        self._step_s = self._health_s = math.nan

    def poll(self) -> None:
        """Take what has come."""
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
        """Since the last new step, or since we began to listen."""
        return self._clock() - (self._began_s if math.isnan(self._step_s) else self._step_s)

    @property
    def news(self) -> News:
        """How good the newest step is."""
        if self.step is None:
            return News.NEVER
        return News.FRESH if self.age_s <= STALE_S else News.STALE

    @property
    def health_fresh(self) -> bool:
        """Whether the newest health is."""
        return self._clock() - self._health_s <= STALE_S  # False for NaN

    @property
    def connections(self) -> int:
        """Open connections to other Zenoh sessions; 0 means that nobody answers, or refuses us."""
        return zenoh_link.transports(self._session)

    @property
    def past_router(self) -> bool:
        """Whether we are a router's peer: it passes on nothing from its other peers."""
        return self._role is zenoh_link.Role.PEER and zenoh_link.knows_router(self._session)

    @property
    def over(self) -> bool:
        """Whether the onboard process said that the flight is over."""
        return self.step is not None and self.step.finished

    def _payloads(self, name: str) -> list[bytes]:
        return [sample.payload.to_bytes() for sample in zenoh_link.drain(self._subscribers[name])]

    def _decode(self, unpack: Callable[[bytes], Any], payload: bytes) -> Any:
        try:
            return unpack(payload)
        except ValueError:  # another version, or somebody else's key: counted and shown
            self.refused += 1
            return None
