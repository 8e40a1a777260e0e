"""Reports every two seconds what the onboard process waits for, and when the vehicle has fallen silent."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict

from bridge.mavlink.client.link import VehicleLink
from bridge.mavlink.client.silence import Arrivals, why_silent
from flightstack.core.controller import WARN, Outputs
from flightstack.core.memory import Memory
from flightstack.core.parameters.flight import FlightConfig
from flightstack.core.types import Phase
from flightstack.onboard.waiting import PERIOD_S, TargetSeen, VehicleSeen, countdown, missing
from flightstack.onboard.zenoh_wires import ZenohWires

_REASON_SEVERITY = 4  # MAV_SEVERITY_WARNING; what is less urgent is no reason
_REASONS = 3  # texts of the vehicle that are repeated
_REASON_AGE_MAX_S = 15.0  # s; PX4 and ArduPilot repeat why they do not arm within that time
_PROBLEMS = 2  # about samples, in one report


class WaitReport:
    """Call ``note_text`` with the vehicle's texts and ``step`` in every tick.

    Attributes:
        lacking: what was missing at the last report, while the flight waits and after it was given up.
    """

    def __init__(
        self, config: FlightConfig, system_id: int, link: VehicleLink, wires: ZenohWires, *, searches: bool
    ) -> None:
        """Set up.

        Args:
            config: of the flight.
            system_id: of the vehicle.
            link: to it.
            wires: of the target.
            searches: look for other keys while no sample comes.
        """
        self.lacking: tuple[str, ...] = ()
        self._config, self._system_id, self._link, self._wires = config, system_id, link, wires
        self._searches = searches
        self._due_s = PERIOD_S
        self._arrivals = Arrivals()
        self._refused: dict[str, int] = {}
        self._arrived = self._refused_before = 0  # samples of the target
        self._texts: deque[tuple[float, str]] = deque(maxlen=_REASONS)
        self._refusals: deque[str] = deque(maxlen=_PROBLEMS)

    def note_text(self, now_s: float, severity: int, text: str) -> None:
        """Take a text of the vehicle."""
        if severity <= _REASON_SEVERITY and all(text != known for _, known in self._texts):
            self._texts.append((now_s, text))
        elif severity <= _REASON_SEVERITY:
            self._texts = deque(((now_s if t == text else s, t) for s, t in self._texts), maxlen=_REASONS)

    def step(
        self, out: Outputs, memory: Memory, arrived: int, problems: Sequence[str], now_s: float
    ) -> str | None:
        """Return what a person should read now, if anything.

        Args:
            out: of this tick.
            memory: of the controller, after it.
            arrived: samples of the target in this tick.
            problems: why some of them could not be decoded.
            now_s: the stack's clock.
        """
        phase = out.phase
        if phase not in (Phase.WAIT, Phase.ABORT):
            self.lacking = ()
        if phase is Phase.WAIT:
            self._arrived += arrived
            self._refusals.extend(text for text in problems if text not in self._refusals)
            for event in out.events:  # while it waits the controller warns of refused samples alone
                if event.level == WARN and event.text not in self._refusals:
                    self._refusals.append(event.text)
        else:
            self._wires.search.stop()
        if now_s < self._due_s or phase is Phase.LANDED:
            return None
        self._due_s = now_s + PERIOD_S
        if phase is Phase.WAIT:
            return self._waiting(out, memory, now_s)
        return self._silent(out, memory, now_s)

    def _waiting(self, out: Outputs, memory: Memory, now_s: float) -> str | None:
        self.lacking = missing(self._vehicle(out, now_s), self._target(out), self._config.checks)
        self._refusals.clear()
        if not self.lacking:
            return None
        left = countdown(self._config, Phase.WAIT, now_s - memory.phase_since_s)
        return f"waiting: {'; '.join(self.lacking)}; {left}"

    def _silent(self, out: Outputs, memory: Memory, now_s: float) -> str | None:
        grown = self._arrivals.grown(self._link.endpoint.counters)
        status = out.seen.inputs.status
        if out.seen.link_ok or status is None:
            return None
        heard_s = now_s - status.arrival_s
        text = why_silent(self._system_id, grown, self._link.counters.senders, heard_s=heard_s)
        left = countdown(self._config, out.phase, now_s - memory.phase_since_s)
        return f"{text}; {left}" if left else text

    def _vehicle(self, out: Outputs, now_s: float) -> VehicleSeen:
        link, own, status = self._link, out.seen.inputs.own, out.seen.inputs.status
        grown = self._arrivals.grown(link.endpoint.counters)
        heard_s = now_s - status.arrival_s if status is not None else None
        own_age_s = now_s - own.arrival_s if own is not None else None
        before, self._refused = self._refused, asdict(link.state.counters)
        return VehicleSeen(
            heartbeat_age_s=heard_s,
            silence=why_silent(self._system_id, grown, link.counters.senders, heard_s=heard_s),
            own_age_s=own_age_s,
            own_believed=out.seen.own_ok
            or own_age_s is None
            or own_age_s > self._config.checks.own_age_max_s,
            refused={name: n - before.get(name, 0) for name, n in self._refused.items()},
            status=status,
            readiness_told=link.state.battery is not None,
            says=tuple(text for at_s, text in self._texts if now_s - at_s <= _REASON_AGE_MAX_S),
        )

    def _target(self, out: Outputs) -> TargetSeen:
        target, wires = out.seen.target, self._wires
        refused, self._refused_before = wires.odometry.refused - self._refused_before, wires.odometry.refused
        arrived, self._arrived = self._arrived + refused, 0
        age_s = target.age_s if target is not None else None
        lost = age_s is None or age_s > self._config.checks.target_age_max_s
        search = self._searches and lost and not arrived
        if not search:
            wires.search.stop()
        found = dict.fromkeys((*wires.odometry.told[-_PROBLEMS:], *self._refusals))
        problems = tuple(text.removeprefix(f"{wires.target.text}: ") for text in found)[:_PROBLEMS]
        return TargetSeen(
            name=wires.target.text,
            age_s=age_s if age_s is None or math.isfinite(age_s) else None,
            arrived=arrived,
            problems=problems,
            keys=wires.search.keys() if search else (),
        )
